"""Laws, control points and candidates that must be refused, and what is said then."""

import pytest
from anisotropic_project import write_anisotropic_project
from small_project import write_small_project
from wording import says

from softcal_jax.project import ProjectError, load_project

THETA_BOUNDS = 'lower = "-90 deg"\nupper = "90 deg"'
POSITIONS = 'positions = { "CP 1" = "(0, 7.5, 7.5) mm", "CP 2" = "(150, 7.5, 7.5) mm" }'
E_L = 'field = "E_l"\n'


def problems_of(path):
    """The messages, without the file they are about."""
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ").split("\n- ")


CASES = {
    "missing constants": (
        ('E_t = "700 kPa"\n', ""),
        'material.E_t: missing ... "700 kPa"',
    ),
    "missing angle": (
        ('theta = "10 deg"\n', ""),
        'material.theta: missing ... "20 deg"',
    ),
    "angle without a unit": (
        ('theta = "10 deg"', "theta = 10"),
        'material.theta: 10 has no unit ... "20 deg"',
    ),
    "angle in a wrong unit": (
        ('theta = "10 deg"', 'theta = "10 dge"'),
        'material.theta: "10 dge": unknown unit "dge" ... "20 deg" ... mean "deg"',
    ),
    "constant of another elasticity": (
        ("nu = 0.3", 'nu = 0.3\nmu_l = "200 kPa"'),
        'material.mu_l: ... "transverse-isotropic" ... "transverse-hyperelastic" ... '
        "E_t, E_l, nu, theta, phi",
    ),
    "isotropic constant": (
        ("nu = 0.3", 'nu = 0.3\nE = "1 MPa"'),
        'material.E: ... "isotropic" ... "neo-hookean"',
    ),
    "constant of another law in a region": (
        (
            "[control_points.ends]",
            '[material.regions.half]\nE = "1 MPa"\n\n[control_points.ends]',
        ),
        "material.regions.half.E: ... E ... elasticity",
    ),
    "parameter of another law": (
        (E_L, 'field = "mu_l"\n'),
        'parameters.mu_l.field: ... "transverse-isotropic"',
    ),
    "elasticity of a law that has none": (
        ('law = "corotational"', 'law = "transverse-hyperelastic"'),
        'material.elasticity: ... "corotational" ... "classical-corotational" ... '
        '"st-venant-kirchhoff" ... E_t, E_l, nu, mu_l, theta',
    ),
    "unknown elasticity": (
        ('"reduced-transverse-isotropic"', '"reduced"'),
        'material.elasticity: got "reduced" ... "isotropic"',
    ),
    "unknown plane": (
        ('print_plane = "xz"', 'print_plane = "zx"'),
        'material.print_plane: got "zx" ... "xy", "xz", "yz"',
    ),
    "set without a name": (
        ("[control_points.ends]", "[control_points]"),
        "control_points: ... name ... [control_points.ends] ... control_points = "
        '"ends"',
    ),
    "unknown set": (
        (f'{E_L}control_points = "ends"', f'{E_L}control_points = "end"'),
        'parameters.E_l: ... "end" ... mean "ends" ... Known: ends',
    ),
    "no positions": (
        (POSITIONS, ""),
        "control_points.ends.positions: missing",
    ),
    "position without a unit": (
        ('"CP 1" = "(0, 7.5, 7.5) mm"', '"CP 1" = "(0, 7.5, 7.5)"'),
        'control_points.ends.positions.CP 1: "(0, 7.5, 7.5)" has no unit',
    ),
    "names twice": (
        ("power = 2", 'names = ["a", "b"]'),
        "control_points.ends: `positions` ... leave",
    ),
    "too few names": (
        (POSITIONS, 'positions = ["(0, 0, 0) mm"]\nnames = ["a", "b"]'),
        "control_points.ends: 1 control points ... names, got a, b",
    ),
    "power": (
        ("power = 2", "power = 0"),
        "control_points.ends: power ... positive ... got 0",
    ),
    "nearest": (
        ("power = 2", "nearest = 3"),
        "control_points.ends: nearest ... from 1",
    ),
    "coinciding": (
        ('"CP 2" = "(150, 7.5, 7.5) mm"', '"CP 2" = "(0, 7.5, 7.5) mm"'),
        "control_points.ends: ... 'CP 1' and 'CP 2' coincide",
    ),
    "far outside": (
        ('"CP 2" = "(150, 7.5, 7.5) mm"', '"CP 2" = "(150, 7.5, 7.5) cm"'),
        "parameters: ... 'CP 2' of E_t ... 1.35 m from the body",
    ),
    "start of an unknown point": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 3" = "0.6 MPa" }'),
        'parameters.E_t.start: ... "CP 3" ... mean "CP 2" ... CP 1, CP 2',
    ),
    "start in a wrong unit": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 2" = "0.6 mm" }'),
        'parameters.E_t.start: CP 2: "0.6 mm": "mm" is not a pressure',
    ),
    "start outside": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 2" = "6 MPa" }'),
        "parameters.E_t: ... 'E_t of CP 2': ... start 6 MPa ... lower 50 kPa ... "
        "upper 1 MPa",
    ),
    "a bound for one of two": (
        (THETA_BOUNDS, 'lower = { "CP 1" = "-90 deg" }\nupper = "90 deg"'),
        "parameters.theta: lower ... CP 2",
    ),
    "angles crossed": (
        (THETA_BOUNDS, 'lower = "90 deg"\nupper = "-90 deg"'),
        "parameters.theta: ... 'theta of CP 1': ... crossed ... lower 90 deg ... "
        "upper -90 deg",
    ),
    "more than half a turn": (
        (THETA_BOUNDS, 'lower = "-90 deg"\nupper = "120 deg"'),
        "parameters.theta: the bounds of theta span 210 degrees",
    ),
    "a name at control points": (
        (E_L, f'{E_L}name = "soft"\n'),
        'parameters.soft: `name` ... "E_l of CP 1" ... Leave it out',
    ),
    "fixed without control points": (
        (f'{E_L}control_points = "ends"', f'{E_L}fixed = {{ "CP 1" = "1 kPa" }}'),
        "parameters.E_l: ... fixed ... control points",
    ),
    "fixed, but no table": (
        (E_L, f'{E_L}fixed = "1 kPa"\n'),
        'parameters.E_l.fixed: got "1 kPa" ... table',
    ),
    "fixed unknown": (
        (E_L, f'{E_L}fixed = {{ "CP 9" = "1 kPa" }}\n'),
        "parameters.E_l: ... fixed of E_l: 'CP 9' ... CP 1",
    ),
    "tied to nothing": (
        (E_L, f'{E_L}tied = {{ "CP 2" = "E of CP 1" }}\n'),
        "parameters: ... E_l of CP 2 ... tied to ... 'E of CP 1'",
    ),
    "interpolation": (
        (E_L, f'{E_L}interpolation = "axis"\n'),
        'parameters.E_l.interpolation: got "axis" ... "linear", "log"',
    ),
    "values per quadrature point": (
        (E_L, f'{E_L}sampling = "quadrature"\n'),
        'parameters.E_l.sampling: got "quadrature" ... "centroids"',
    ),
    "order of nothing": (
        ("axes = [[", 'order = [["E_x", "E_t"]]\n# [['),
        "parameter_space: order ... 'E_x'",
    ),
    "order of three": (
        ("axes = [[", 'order = [["E_l", "E_t", "theta"]]\n# [['),
        "parameter_space.order[1]: ... 2 values, got 3",
    ),
    "axis of two": (
        ('"E_t", "theta"]]', '"E_t"]]'),
        "parameter_space.axes[1][3]: missing",
    ),
    "axis that cannot turn": (
        (THETA_BOUNDS, 'lower = "-80 deg"\nupper = "90 deg"'),
        "parameter_space: axes ('E_l', 'E_t', 'theta'): 'theta of CP 1' must turn",
    ),
    "start against the order": (
        ("axes = [[", 'order = [["E_t", "E_l"]]\n# [['),
        "parameters: ... E_t of CP 1 above E_l of CP 1 ... order",
    ),
    "axis with the larger modulus first": (
        ('"E_l", "E_t", "theta"', '"E_t", "E_l", "theta"'),
        "parameters: ... E_t of CP 1 above E_l of CP 1 ... axes ... swap",
    ),
    "axis of a misspelt field": (
        ('"E_t", "theta"', '"E_t", "teta"'),
        "parameter_space: axes ... 'teta' ... mean 'theta' ... E_t of CP 1",
    ),
    "control points without a set": (
        (
            f"[control_points.ends]\n{POSITIONS}\npower = 2\n",
            '[control_points]\ntip = "(0, 0, 0) mm"\n',
        ),
        "control_points: got tip ... [control_points.ends]",
    ),
    "parameter at a list of control points": (
        (f'{E_L}control_points = "ends"', f'{E_L}control_points = ["CP 1", "CP 2"]'),
        "parameters.E_l.control_points: got ['CP 1', 'CP 2'] ... text",
    ),
    "support by its name alone": (
        ('supports = [{ group = "x_max" }]', 'supports = "x_max"'),
        'candidates.pose 4.supports: got "x_max" ... list',
    ),
    "measured candidate": (
        ('name = "pose 2"', 'name = "pose 2"\nmeasured.file = "m.csv"'),
        "candidates.pose 2.measured: unknown key",
    ),
    "candidate with a role": (
        ('name = "pose 2"', 'name = "pose 2"\nrole = "validation"'),
        "candidates.pose 2.role: unknown key",
    ),
    "candidate named like a configuration": (
        ('name = "pose 2"', 'name = "pose 1"'),
        "candidates: configuration or candidate 'pose 1' is named more than once",
    ),
    "candidate with an unknown group": (
        ('group = "x_max"', 'group = "x_mx"'),
        "candidates.pose 4.supports[1]: unknown group 'x_mx' ... mean 'x_max'",
    ),
    "candidate with shared gravity": (
        ('[shared]\ngravity = "(0, -9.81, 0) m/s^2"', '[shared]\ngravity = "9.81 m/s"'),
        'shared.gravity: got "9.81 m/s" ... three numbers with a unit',
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_refused(tmp_path, case):
    change, message = CASES[case]
    lines = problems_of(write_anisotropic_project(tmp_path, change))
    assert says(lines, message)


def test_each_law_names_what_it_lacks(tmp_path):
    """All at once, with the other problems of the file."""
    path = write_small_project(
        tmp_path,
        ('"neo-hookean"', '"corotational"\nelasticity = "transverse-isotropic"'),
        ('element = "linear"', 'elemnt = "linear"'),
    )
    first, *problems = problems_of(path)
    assert first == "10 problems."
    assert [problem.split(":")[0] for problem in problems] == [
        "mesh.elemnt",
        *(f"material.{key}" for key in ("E_t", "E_l", "nu_t", "nu_tl", "mu_l")),
        "material.theta",
        "material.E",
        "material.nu",
        "parameters.E.field",
    ]


def test_isotropic_is_the_default(tmp_path):
    path = write_small_project(
        tmp_path, ('"neo-hookean"', '"corotational"'), ("nu = 0.3", "nu_t = 0.3")
    )
    nu, nu_t = problems_of(path)[1:]
    assert says(nu, "material.nu: missing ... 0.499")
    assert says(nu_t, 'material.nu_t: ... "transverse-isotropic"', "elasticity, E, nu")


def test_flattened_regions_are_found_at_reading(tmp_path):
    """One E for a body whose parts differ: said before anything is solved."""
    path = write_small_project(
        tmp_path,
        (
            "[groups.tip]",
            '[groups.half]\nof = "tets"\n'
            'sphere = { centre = "(60, 10, 10) mm", radius = "20 mm" }\n\n[groups.tip]',
        ),
        ("[[parameters]]", '[material.regions.half]\nE = "500 kPa"\n\n[[parameters]]'),
    )
    (text,) = problems_of(path)
    assert says(text, "parameters: ... 'E' ... 200000 and 500000")


def test_nothing_at_all(tmp_path):
    path = write_anisotropic_project(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("[[configurations]]")])
    (problem,) = problems_of(path)
    assert says(problem, "configurations: missing ... [[configurations]]")


def test_constants_that_do_not_fit(tmp_path):
    path = write_anisotropic_project(
        tmp_path,
        ('"reduced-transverse-isotropic"', '"transverse-isotropic"'),
        ("nu = 0.3", 'nu_t = 0.3\nnu_tl = 0.9\nmu_l = "200 kPa"'),
        ('E_t = "700 kPa"', 'E_t = "0.7 MPa"'),
    )
    (problem,) = problems_of(path)
    range_of_nu_tl = "(-0.7826, 0.7826) for E_t = 700 kPa, E_l = 400 kPa, nu_t = 0.3"
    assert says(problem, "material: nu_tl", range_of_nu_tl, "0.9")
