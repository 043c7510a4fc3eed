"""Laws, control points and candidates that must be refused, and what is said then."""

import pytest
from anisotropic_project import write_anisotropic_project
from small_project import write_small_project

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
        'material.E_t: missing. Expected Young\'s modulus across the fibre: "700 kPa".',
    ),
    "missing angle": (
        ('theta = "10 deg"\n', ""),
        'material.theta: missing. Expected angle of the fibre in its print plane: "20',
    ),
    "angle without a unit": (
        ('theta = "10 deg"', "theta = 10"),
        "material.theta: 10 has no unit; expected an angle, in quotes and with its "
        'unit, like "20 deg".',
    ),
    "angle in a wrong unit": (
        ('theta = "10 deg"', 'theta = "10 dge"'),
        'material.theta: "10 dge": unknown unit "dge"; expected an angle, like "20 '
        'deg". Did you mean "deg"?',
    ),
    "constant of another elasticity": (
        ("nu = 0.3", 'nu = 0.3\nmu_l = "200 kPa"'),
        'material.mu_l: mu_l belongs to elasticity = "transverse-isotropic" or law = '
        '"transverse-hyperelastic". This is law = "corotational" with elasticity = '
        '"reduced-transverse-isotropic", which has E_t, E_l, nu, theta, phi, print_p',
    ),
    "isotropic constant": (
        ("nu = 0.3", 'nu = 0.3\nE = "1 MPa"'),
        'material.E: E belongs to elasticity = "isotropic" or law = "neo-hookean". ',
    ),
    "constant of another law in a region": (
        (
            "[control_points.ends]",
            '[material.regions.half]\nE = "1 MPa"\n\n[control_points.ends]',
        ),
        "material.regions.half.E: E belongs to elasticity = ",
    ),
    "parameter of another law": (
        (E_L, 'field = "mu_l"\n'),
        'parameters.mu_l.field: mu_l belongs to elasticity = "transverse-isotropic" ',
    ),
    "elasticity of a law that has none": (
        ('law = "corotational"', 'law = "transverse-hyperelastic"'),
        'material.elasticity: elasticity belongs to law = "corotational", law = '
        '"classical-corotational" or law = "st-venant-kirchhoff". This is law = "tran'
        'sverse-hyperelastic", which has E_t, E_l, nu, mu_l, theta, phi, print_plane, ',
    ),
    "unknown elasticity": (
        ('"reduced-transverse-isotropic"', '"reduced"'),
        'material.elasticity: got "reduced"; expected one of "isotropic", "transverse-',
    ),
    "unknown plane": (
        ('print_plane = "xz"', 'print_plane = "zx"'),
        'material.print_plane: got "zx"; expected one of "xy", "xz", "yz". Did you m',
    ),
    "set without a name": (
        ("[control_points.ends]", "[control_points]"),
        "control_points: a set of control points needs a name: write "
        '[control_points.ends], and control_points = "ends" in [[parameters]].',
    ),
    "unknown set": (
        (f'{E_L}control_points = "ends"', f'{E_L}control_points = "end"'),
        "parameters.E_l: there are no control points 'end'. Did you mean \"ends\"? "
        "Known: ends.",
    ),
    "no positions": (
        (POSITIONS, ""),
        "control_points.ends.positions: missing. Expected names and positions, {",
    ),
    "position without a unit": (
        ('"CP 1" = "(0, 7.5, 7.5) mm"', '"CP 1" = "(0, 7.5, 7.5)"'),
        'control_points.ends.positions.CP 1: "(0, 7.5, 7.5)" has no unit; expected thr',
    ),
    "names twice": (
        ("power = 2", 'names = ["a", "b"]'),
        "control_points.ends: `positions` is a table, which names its points; leave",
    ),
    "too few names": (
        (POSITIONS, 'positions = ["(0, 0, 0) mm"]\nnames = ["a", "b"]'),
        "control_points.ends: 1 control points need as many different names, got a, b.",
    ),
    "power": (
        ("power = 2", "power = 0"),
        "control_points.ends: power must be positive and finite, got 0: with 0 every ",
    ),
    "nearest": (
        ("power = 2", "nearest = 3"),
        "control_points.ends: nearest must lie between 1 and the number of control ",
    ),
    "coinciding": (
        ('"CP 2" = "(150, 7.5, 7.5) mm"', '"CP 2" = "(0, 7.5, 7.5) mm"'),
        "control_points.ends: control points 'CP 1' and 'CP 2' coincide: the data coul",
    ),
    "far outside": (
        ('"CP 2" = "(150, 7.5, 7.5) mm"', '"CP 2" = "(150, 7.5, 7.5) cm"'),
        "parameters: control point 'CP 2' of E_t lies 1.35 m from the body, more than",
    ),
    "start of an unknown point": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 3" = "0.6 MPa" }'),
        "parameters.E_t: start names 'CP 3', which is no control point. Did you mean "
        '"CP 2"? Known: CP 1, CP 2.',
    ),
    "start in a wrong unit": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 2" = "0.6 mm" }'),
        'parameters.E_t.start: CP 2: "0.6 mm": "mm" is not a pressure or modulus; ',
    ),
    "start outside": (
        ('{ "CP 2" = "0.6 MPa" }', '{ "CP 2" = "6 MPa" }'),
        "parameters.E_t: parameter 'E_t of CP 2': the start 6 MPa does not lie "
        "between lower 50 kPa and upper 1 MPa.",
    ),
    "a bound for one of two": (
        (THETA_BOUNDS, 'lower = { "CP 1" = "-90 deg" }\nupper = "90 deg"'),
        "parameters.theta: lower has no value for CP 2.",
    ),
    "angles crossed": (
        (THETA_BOUNDS, 'lower = "90 deg"\nupper = "-90 deg"'),
        "parameters.theta: parameter 'theta of CP 1': the bounds are crossed, lower 90 "
        "deg is not below upper -90 deg.",
    ),
    "more than half a turn": (
        (THETA_BOUNDS, 'lower = "-90 deg"\nupper = "120 deg"'),
        "parameters.theta: the bounds of theta span 210 degrees: an axis is the same",
    ),
    "a name at control points": (
        (E_L, f'{E_L}name = "soft"\n'),
        "parameters.soft: `name` is for a single parameter; at control points the "
        'names are made, like "E_l of CP 1". Leave it out.',
    ),
    "fixed without control points": (
        (f'{E_L}control_points = "ends"', f'{E_L}fixed = {{ "CP 1" = "1 kPa" }}'),
        "parameters.E_l: fixed is for control points: name a set of them, like ",
    ),
    "fixed, but no table": (
        (E_L, f'{E_L}fixed = "1 kPa"\n'),
        "parameters.E_l.fixed: got '1 kPa'; expected a table of control points and ",
    ),
    "fixed unknown": (
        (E_L, f'{E_L}fixed = {{ "CP 9" = "1 kPa" }}\n'),
        "parameters.E_l: fixed of E_l: there is no control point 'CP 9'; there are CP ",
    ),
    "tied to nothing": (
        (E_L, f'{E_L}tied = {{ "CP 2" = "E of CP 1" }}\n'),
        "parameters: E_l of CP 2 is tied to 'E of CP 1', which is no parameter; there ",
    ),
    "interpolation": (
        (E_L, f'{E_L}interpolation = "axis"\n'),
        'parameters.E_l.interpolation: got "axis"; expected one of "linear", "log", "d',
    ),
    "order of nothing": (
        ("axes = [[", 'order = [["E_x", "E_t"]]\n# [['),
        "parameter_space: order names 'E_x', which is neither a parameter nor a field",
    ),
    "order of three": (
        ("axes = [[", 'order = [["E_l", "E_t", "theta"]]\n# [['),
        "parameter_space.order[1]: expected 2 values, got 3.",
    ),
    "axis of two": (
        ('"E_t", "theta"]]', '"E_t"]]'),
        "parameter_space.axes[1][3]: missing; the list is too short.",
    ),
    "axis that cannot turn": (
        (THETA_BOUNDS, 'lower = "-80 deg"\nupper = "90 deg"'),
        "parameter_space: axes ('E_l', 'E_t', 'theta'): 'theta of CP 1' must turn free",
    ),
    "start against the order": (
        ("axes = [[", 'order = [["E_t", "E_l"]]\n# [['),
        "parameters: the start has E_t of CP 1 above E_l of CP 1, but order asks for E",
    ),
    "axis with the larger modulus first": (
        ('"E_l", "E_t", "theta"', '"E_t", "E_l", "theta"'),
        "parameters: the start has E_t of CP 1 above E_l of CP 1, but axes names the s"
        "maller modulus first: swap the two there, or start with equal or ordered ",
    ),
    "axis of a misspelt field": (
        ('"E_t", "theta"', '"E_t", "teta"'),
        "parameter_space: axes names 'teta', which is neither a parameter nor a field "
        "with control points. Did you mean 'theta'? Parameters are E_t of CP 1, E_t of",
    ),
    "control points without a set": (
        (
            f"[control_points.ends]\n{POSITIONS}\npower = 2\n",
            '[control_points]\ntip = "(0, 0, 0) mm"\n',
        ),
        'control_points: got "tip" = "(0, 0, 0) mm"; expected sets of control points, '
        "each with a name: write [control_points.ends] and below positions = ",
    ),
    "parameter at a list of control points": (
        (f'{E_L}control_points = "ends"', f'{E_L}control_points = ["CP 1", "CP 2"]'),
        "parameters.E_l.control_points: got ['CP 1', 'CP 2']; expected the name of one",
    ),
    "support by its name alone": (
        ('supports = [{ group = "x_max" }]', 'supports = "x_max"'),
        'candidates.pose 4.supports: got "x_max"; expected a list of tables, like [{ g',
    ),
    "measured candidate": (
        ('name = "pose 2"', 'name = "pose 2"\nmeasured.file = "m.csv"'),
        "candidates.pose 2.measured: a candidate is what might be measured; once it "
        "is, make it one of [[configurations]].",
    ),
    "candidate with a role": (
        ('name = "pose 2"', 'name = "pose 2"\nrole = "validation"'),
        "candidates.pose 2.role: unknown key. ",
    ),
    "candidate named like a configuration": (
        ('name = "pose 2"', 'name = "pose 1"'),
        "candidates: 'pose 1' is a configuration already; give the candidate a name of",
    ),
    "candidate with an unknown group": (
        ('group = "x_max"', 'group = "x_mx"'),
        "candidates.pose 4.supports[1]: unknown group 'x_mx'. Did you mean 'x_max'",
    ),
    "candidate with shared gravity": (
        ('[shared]\ngravity = "(0, -9.81, 0) m/s^2"', '[shared]\ngravity = "9.81 m/s"'),
        'shared.gravity: got "9.81 m/s"; expected three numbers with a unit',
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_refused(tmp_path, case):
    change, message = CASES[case]
    lines = problems_of(write_anisotropic_project(tmp_path, change))
    assert any(line.startswith(message) for line in lines), lines


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


def test_isotropic_is_the_default_and_says_so(tmp_path):
    path = write_small_project(
        tmp_path, ('"neo-hookean"', '"corotational"'), ("nu = 0.3", "nu_t = 0.3")
    )
    assert problems_of(path)[1:] == [
        "material.nu: missing. Expected Poisson's ratio: 0.499.",
        'material.nu_t: nu_t belongs to elasticity = "transverse-isotropic". This is '
        'law = "corotational" with elasticity = "isotropic", which has E, nu.',
    ]


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
    assert text.startswith(
        "parameters: parameter 'E' would give the whole body one value of E, which now "
        "lies between 200000 and 500000."
    )


def test_nothing_at_all(tmp_path):
    path = write_anisotropic_project(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("[[configurations]]")])
    assert problems_of(path) == [
        "configurations: missing. Expected at least one table [[configurations]]."
    ]


def test_constants_that_do_not_fit_are_quoted_as_they_are_typed(tmp_path):
    path = write_anisotropic_project(
        tmp_path,
        ('"reduced-transverse-isotropic"', '"transverse-isotropic"'),
        ("nu = 0.3", 'nu_t = 0.3\nnu_tl = 0.9\nmu_l = "200 kPa"'),
        ('E_t = "700 kPa"', 'E_t = "0.7 MPa"'),
    )
    (problem,) = problems_of(path)
    assert problem == (
        "material: nu_tl must lie in (-0.7826, 0.7826) for E_t = 700 kPa, E_l = 400 "
        "kPa, nu_t = 0.3, or the stiffness is not positive definite; got 0.9. The file "
        'has E_t = "0.7 MPa".'
    )
