"""Input files of CalculiX and Abaqus: read back, checked by hand, and run."""

import re
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import meshio
import numpy as np
import pytest
from wording import says

from benchmarks._calculix import (
    SAME,
    SIMILAR,
    SIZE,
    bar,
    bent_bar,
    difference,
    incompressible,
    inflated,
    isotropic,
    lane_of,
    missing,
    tip_edge,
)
from benchmarks._hollow import hollow_cube
from softcal_jax.actuators import Cable, Chamber, Guide
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import (
    Configuration,
    EdgeForce,
    ImposedDisplacement,
    ImposedForce,
    Support,
)
from softcal_jax.equilibrium import build_model, linearise
from softcal_jax.exchange.inp import write_inp
from softcal_jax.materials import (
    Corotational,
    Fibre,
    FibreReinforced,
    Gent,
    Isotropic,
    MooneyRivlin,
    NeoHookean,
    Ogden,
    StVenantKirchhoff,
    TransverseIsotropic,
    Yeoh,
)
from softcal_jax.mesh import read_mesh


class Block(NamedTuple):
    """A keyword with its options, and the numbers or names below it."""

    keyword: str
    options: dict
    rows: list


def blocks_of(path):
    """Read an input file by its rules: keyword lines, data lines, comments."""
    blocks, going_on = [], False
    for line in path.read_text().splitlines():
        assert len(line) <= 256
        if line.startswith("**"):
            continue
        if line.startswith("*"):
            name, *options = [part.strip() for part in line[1:].split(",")]
            pairs = (option.partition("=") for option in options)
            blocks.append(Block(name, {k: v for k, _, v in pairs}, []))
            going_on = False
            continue
        cells = [cell.strip() for cell in line.split(",")]
        rows = blocks[-1].rows
        values = [cell for cell in cells if cell]
        assert all(len(value) <= 20 for value in values) or len(blocks) == 1
        rows[-1:] = [rows[-1] + values] if going_on else [*rows[-1:], values]
        going_on = cells[-1] == ""
    return blocks


def only(blocks, keyword, **options):
    return [
        b
        for b in blocks
        if b.keyword == keyword and options.items() <= b.options.items()
    ]


@pytest.mark.parametrize("order", [1, 2])
def test_mesh_is_read_back(order, tmp_path):
    """By meshio and by our own reader; groups are sets."""
    model = bar(NeoHookean(2e5, 0.4), order=order)
    lane = lane_of(model, Configuration("droop", "x_min"))
    write_inp(tmp_path / "job.inp", model, lane, title="*STEP\nof ours")
    raw = meshio.read(tmp_path / "job.inp")
    np.testing.assert_allclose(raw.points, model.mesh.points, atol=1e-14)
    np.testing.assert_array_equal(raw.cells[0].data, model.mesh.tets)
    mesh = read_mesh(tmp_path / "job.inp", length_unit="m")
    assert mesh.order == order
    np.testing.assert_array_equal(
        mesh.node_groups["N_TIP_EDGE"], model.mesh.node_groups["tip & edge"]
    )
    (heading,) = only(blocks_of(tmp_path / "job.inp"), "HEADING")
    assert heading.rows == [["STEP of ours"]]


def test_mid_nodes_stand_where_the_manual_has_them(tmp_path):
    """C3D10 of the manual: 5 to 10 between 1-2, 2-3, 1-3, 1-4, 2-4, 3-4."""
    model = bar(NeoHookean(2e5, 0.4))
    write_inp(
        tmp_path / "job.inp", model, lane_of(model, Configuration("droop", "x_min"))
    )
    blocks = blocks_of(tmp_path / "job.inp")
    (nodes,), (tets,) = only(blocks, "NODE"), only(blocks, "ELEMENT", TYPE="C3D10")
    x = {int(i): np.array(at, float) for i, *at in nodes.rows}
    pairs = [(1, 2), (2, 3), (1, 3), (1, 4), (2, 4), (3, 4)]
    for _, *numbers in tets.rows:
        corner = {k + 1: x[int(node)] for k, node in enumerate(numbers[:4])}
        for node, (a, b) in zip(numbers[4:], pairs, strict=True):
            middle = 0.5 * (corner[a] + corner[b])
            np.testing.assert_allclose(x[int(node)], middle, atol=1e-12)


def test_supports_and_loads(tmp_path):
    """Gravity has its size and direction, forces their sum, supports their nodes."""
    model = bar(NeoHookean(2e5, 0.4))
    moved = Support("x_max", axes="y", displacement=(0.0, 2e-3, 0.0))
    configuration = Configuration(
        "pulled",
        ["x_min", moved],
        gravity=(3.0, 0.0, -4.0),
        loads=EdgeForce(tip_edge(model.mesh), (0.01, 0.0, -0.06)),
    )
    write_inp(tmp_path / "job.inp", model, lane_of(model, configuration))
    blocks = blocks_of(tmp_path / "job.inp")
    (step,) = only(blocks, "STEP")
    assert "NLGEOM" in step.options
    (gravity,) = only(blocks, "DLOAD")
    assert gravity.rows == [["E1", "GRAV", "5", "0.6", "0", "-0.8"]]
    (loads,) = only(blocks, "CLOAD")
    total = np.zeros(3)
    for node, axis, value in loads.rows:
        assert int(node) - 1 in tip_edge(model.mesh)
        total[int(axis) - 1] += float(value)
    np.testing.assert_allclose(total, [0.01, 0.0, -0.06], atol=1e-15)
    (held,) = only(blocks, "BOUNDARY")
    clamped = set(model.mesh.node_groups["x_min"] + 1)
    slid = set(model.mesh.node_groups["x_max"] + 1)
    expected = {(node, axis, axis, 0.0) for node in clamped for axis in (1, 2, 3)}
    expected |= {(node, 2, 2, 2e-3) for node in slid}
    conditions = {tuple(map(float, row)) for row in held.rows}
    assert conditions == expected


def test_elastic_supports_are_springs(tmp_path):
    """To the ground, stiffness times area along each axis; and between nodes.

    Together they are the forces of the model for any displacement.
    """
    model = bar(NeoHookean(2e5, 0.4))
    soft = Support("x_min", axes="xz", stiffness=1e7)
    lane = lane_of(model, Configuration("soft", [soft, Support("x_max", axes="y")]))
    write_inp(tmp_path / "job.inp", model, lane)
    blocks = blocks_of(tmp_path / "job.inp")
    springs = [
        block
        for block in only(blocks, "ELEMENT")
        if block.options["TYPE"].startswith("SPRING")
    ]
    numbers = [int(row[0]) for block in springs for row in block.rows]
    assert numbers == list(range(model.n_tets + 1, model.n_tets + 1 + len(numbers)))
    u = np.random.default_rng(0).normal(size=model.mesh.points.shape)
    total, force = np.zeros(3), np.zeros_like(u)
    for elements, spring in zip(springs, only(blocks, "SPRING"), strict=True):
        assert elements.options["ELSET"] == spring.options["ELSET"]
        axes, (stiffness,) = spring.rows
        k = int(axes[0]) - 1
        assert elements.options["TYPE"] == f"SPRING{len(axes)}"
        for _, *ends in elements.rows:
            first, *second = (int(node) - 1 for node in ends)
            stretch = u[first, k] - sum(u[node, k] for node in second)
            total[k] += float(stiffness) * (not second)
            force[first, k] += float(stiffness) * stretch
            force[second, k] -= float(stiffness) * stretch
    np.testing.assert_allclose(total, [1e7 * 4e-4, 0.0, 1e7 * 4e-4], rtol=1e-9)
    of_model = jax.jit(lambda u: linearise(model, lane, u).posed.spring_force(u))
    expected = of_model(jnp.asarray(u))
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-6)


def test_a_material_for_each_set_of_values(tmp_path):
    """Tets of equal constants share one; every tet has its own values."""
    E = np.where(np.arange(12) % 3 == 0, 1e5, 3e5)
    model = bar(
        NeoHookean(E, 0.4), density=np.linspace(900.0, 1100.0, 2)[[0] * 6 + [1] * 6]
    )
    lane = lane_of(model, Configuration("droop", "x_min"))
    write_inp(tmp_path / "job.inp", model, lane)
    blocks = blocks_of(tmp_path / "job.inp")
    sets = {b.options["ELSET"]: b.rows for b in only(blocks, "ELSET")}
    assert len(sets) == 4
    names = [b.options["NAME"] for b in only(blocks, "MATERIAL")]
    constants = [b.rows for b in only(blocks, "HYPERELASTIC")]
    densities = [float(b.rows[0][0]) for b in only(blocks, "DENSITY")]
    of = dict(zip(names, zip(constants, densities, strict=True), strict=True))
    seen = []
    for section in only(blocks, "SOLID SECTION"):
        ((C10, D1),), rho = of[section.options["MATERIAL"]]
        for row in sets[section.options["ELSET"]]:
            for tet in map(int, row):
                seen.append(tet)
                np.testing.assert_allclose(float(C10), E[tet - 1] / 2.8 / 2)
                np.testing.assert_allclose(2 / float(D1), E[tet - 1] / 0.6)
                assert rho == (900.0 if tet <= 6 else 1100.0)
    assert sorted(seen) == list(range(1, 13))


def card_of(law, folder):
    """Keyword line and first constants of a law, and what is said of it."""
    model = bar(law)
    lane = lane_of(model, Configuration("droop", "x_min"))
    notes = write_inp(folder / "job.inp", model, lane)
    text = (folder / "job.inp").read_text()
    line = re.search(r"\*MATERIAL.*\n(.*)\n", text).group(1)
    keyword = line[1:].partition(",")[0]
    (block,) = only(blocks_of(folder / "job.inp"), keyword)
    return line, [float(value) for row in block.rows for value in row], notes


K = 2 * 1.45 / (3 * 0.1)
"""Bulk over shear modulus for nu = 0.45."""


@pytest.mark.parametrize(
    ("law", "line", "constants"),
    [
        (StVenantKirchhoff(Isotropic(2e5, 0.3)), "*ELASTIC", [2e5, 0.3]),
        (Corotational(Isotropic(2e5, 0.3)), "*ELASTIC", [2e5, 0.3]),
        (
            MooneyRivlin(3e4, 2e4, 0.45),
            "*HYPERELASTIC, MOONEY-RIVLIN",
            [3e4, 2e4, 2 / (1e5 * K)],
        ),
        (
            Yeoh(3e4, -100.0, 5.0, 0.45),
            "*HYPERELASTIC, YEOH",
            [3e4, -100.0, 5.0, 2 / (6e4 * K), 1e20, 1e20],
        ),
        # mu_i of the programs is mu_p alpha_p / 2; their sum is the shear modulus.
        (
            Ogden(5e4, 1.3, -2e3, -2.0, nu=0.45),
            "*HYPERELASTIC, OGDEN, N=2",
            [3.25e4, 1.3, 2e3, -2.0, 2 / (3.45e4 * K), 1e20],
        ),
    ],
)
def test_constants_of_the_laws(law, line, constants, tmp_path):
    card = card_of(law, tmp_path)
    assert card[0] == line
    np.testing.assert_allclose(card[1], constants, rtol=1e-11)


def test_ogden_of_three_terms_takes_two_lines(tmp_path):
    """CalculiX reads eight constants from the first line, D3 from the second."""
    law = Ogden(5e4, 1.3, 2e3, 3.0, -1e3, -2.0, nu=0.45)
    model = bar(law)
    lane = lane_of(model, Configuration("droop", "x_min"))
    write_inp(tmp_path / "job.inp", model, lane)
    lines = (tmp_path / "job.inp").read_text().splitlines()
    at = lines.index("*HYPERELASTIC, OGDEN, N=3")
    assert len([c for c in lines[at + 1].split(",") if c.strip()]) == 8
    assert lines[at + 2] == "1e+20"


def test_anisotropic_constants_stand_in_the_order_of_the_manual(tmp_path):
    """Fibre along x: C1111 is the soft one, and its place is the first.

    The compliance is that of the engineering constants, inverted here.
    """
    E_t, E_l, nu_t, nu_tl, mu_l = 6e5, 2e5, 0.3, 0.25, 1e5
    S = np.zeros((6, 6))
    S[0, 0], S[1, 1], S[2, 2] = 1 / E_l, 1 / E_t, 1 / E_t
    S[0, 1] = S[1, 0] = S[0, 2] = S[2, 0] = -nu_tl / E_t
    S[1, 2] = S[2, 1] = -nu_t / E_t
    S[3, 3] = S[4, 4] = 1 / mu_l  # 12 and 13
    S[5, 5] = 2 * (1 + nu_t) / E_t  # 23
    C = np.linalg.inv(S)
    law = TransverseIsotropic(E_t, E_l, nu_t, nu_tl, mu_l, Fibre(0.0))
    line, constants, _ = card_of(Corotational(law), tmp_path)
    assert line == "*ELASTIC, TYPE=ANISO"
    # D1111, D1122, D2222, D1133, D2233, D3333, D1112, ..., columns of the triangle.
    expected = [C[i, j] for j in range(6) for i in range(j + 1)]
    np.testing.assert_allclose(constants, expected, rtol=1e-10, atol=1e-6)
    blocks = blocks_of(tmp_path / "job.inp")
    (section,) = only(blocks, "SOLID SECTION")
    (axes,) = only(blocks, "ORIENTATION")
    assert section.options["ORIENTATION"] == axes.options["NAME"]
    assert axes.rows == [["1", "0", "0", "0", "1", "0"]]


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (StVenantKirchhoff(Isotropic(2e5, 0.3)), "former is the law"),
        (Corotational(Isotropic(2e5, 0.3)), "15 % ... strain ... 10 %"),
        (NeoHookean(2e5, 0.3), "NEO HOOKE ... (J - 1)^2 / D1"),
        (Yeoh(3e4, 0.0, 0.0, 0.45), "costs (J - 1)^2 / D1"),
        (Yeoh(3e4, 0.0, 0.0, 0.499), "C3D10H for C3D10"),
    ],
)
def test_what_differs_is_said_and_stands_in_the_file(law, said, tmp_path):
    notes = card_of(law, tmp_path)[2]
    assert says(" ".join(notes), said)
    text = (tmp_path / "job.inp").read_text()
    comments = [line[3:] for line in text.splitlines() if line.startswith("** ")]
    assert says(" ".join(comments), said)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (Gent(3e4, 80.0, 0.45), "Gent .*no counterpart.*calibrate Yeoh"),
        (
            FibreReinforced(NeoHookean(2e5, 0.4), 1e6, Fibre(0.0)),
            "FibreReinforced .*no counterpart.*Holzapfel",
        ),
        (Yeoh(3e4, 0.0, 0.0, 0.4999999), r"D1 .* 6\.67e-12 .* 1e-10 .*0\.499"),
    ],
)
def test_laws_that_are_refused(law, message, tmp_path):
    model = bar(law)
    lane = lane_of(model, Configuration("droop", "x_min"))
    with pytest.raises(ValueError, match=message):
        write_inp(tmp_path / "job.inp", model, lane)
    assert list(tmp_path.iterdir()) == []


def test_robots_that_are_refused(tmp_path):
    path, law = tmp_path / "job.inp", NeoHookean(2e5, 0.4)
    cable = Cable("left", [Guide((0.05, 0.01, 0.02)), Guide((0.1, 0.01, 0.02))])
    model = bar(law, actuators=[cable])
    still = lane_of(model, Configuration("still", "x_min"))
    write_inp(path, model, still)
    pulled = Configuration("pulled", "x_min", actuation={"left": ImposedForce(1.0)})
    with pytest.raises(ValueError, match=r"cable 'left' .*only chambers"):
        write_inp(path, model, lane_of(model, pulled))
    wound = {"left": ImposedDisplacement(1e-3)}
    wound = Configuration("wound", "x_min", actuation=wound)
    with pytest.raises(ValueError, match=r"cable 'left': .*Impose the force"):
        write_inp(path, model, lane_of(model, wound))
    capped = bar(law, bodies=[RigidBody("cap", "x_max")])
    with pytest.raises(ValueError, match=r"bodies \(cap\).*`base_radius`"):
        write_inp(path, capped, lane_of(capped, Configuration("droop", "x_min")))
    moved = Support("x_min", displacement=(1e-3, 0, 0), stiffness=1e7)
    with pytest.raises(ValueError, match="elastic support is moved"):
        write_inp(path, model, lane_of(model, Configuration("moved", moved)))
    with pytest.raises(ValueError, match=r"\.inp, got 'job\.txt'"):
        write_inp(tmp_path / "job.txt", model, still)


FACES = {"P1": (1, 2, 3), "P2": (1, 4, 2), "P3": (2, 4, 3), "P4": (3, 4, 1)}
"""Corners of the faces of a tet in the manual."""


@pytest.mark.parametrize("order", [1, 2])
def test_pressure_acts_on_the_wall(order, tmp_path):
    model, lane = inflated(order)
    write_inp(tmp_path / "job.inp", model, lane)
    blocks = blocks_of(tmp_path / "job.inp")
    (tets,), (loads,) = only(blocks, "ELEMENT"), only(blocks, "DLOAD")
    nodes = {row[0]: [int(n) for n in row[1:]] for row in tets.rows}
    faces = set()
    for tet, face, value in loads.rows:
        assert float(value) == 2e3
        faces.add(frozenset(nodes[tet][k - 1] - 1 for k in FACES[face]))
    wall = model.mesh.surface_groups["cavity"][:, :3]
    assert faces == {frozenset(face) for face in wall.tolist()}
    assert len(loads.rows) == len(wall)
    assert not only(blocks, "DENSITY")


@pytest.mark.parametrize("order", [1, 2])
def test_a_sealed_wall_must_be_held_at_its_rim(order, tmp_path):
    """One face fewer leaves a rim of three corners, and their mid nodes."""
    full = hollow_cube(order=order)
    rim, *wall = full.surface_groups["cavity"]
    mesh = full.with_surface_group("wall", np.array(wall))
    mesh = mesh.with_node_group("rim", rim).with_node_group("one", rim[-1:])
    mesh = mesh.with_node_group("others", rim[:-1])
    base = np.flatnonzero(np.isclose(mesh.points[:, 2], -0.5))
    mesh = mesh.with_node_group("base", base)
    sealed = Chamber("c", "wall", seal=True)
    model = build_model(mesh, NeoHookean(2e5, 0.4), density=0.0, actuators=[sealed])
    posed = partial(
        Configuration, "blown", gravity=(0, 0, 0), actuation={"c": ImposedForce(2e3)}
    )
    write_inp(tmp_path / "job.inp", model, lane_of(model, posed(["base", "rim"])))
    (loads,) = only(blocks_of(tmp_path / "job.inp"), "DLOAD")
    assert len(loads.rows) == len(wall)
    loose = lane_of(model, posed(["base", "others", Support("one", "yz")]))
    with pytest.raises(ValueError, match=r"chamber 'c': .*rim .* 1 nodes .*Hold"):
        write_inp(tmp_path / "loose.inp", model, loose)


needs_calculix = pytest.mark.skipif(missing(), reason="CalculiX (ccx) is not installed")

ALLOWED = {
    "neo-hookean, nu 0.3": 5e-3,
    "neo-hookean, nu 0.45": 2e-3,
    "corotational": 1e-2,
    "corotational, anisotropic": 1e-2,
}
"""Of the laws that agree for small strain alone."""


@pytest.mark.slow
@needs_calculix
@pytest.mark.parametrize("name", [*SAME, *SIMILAR])
def test_calculix_bends_a_bar_as_we_do(name, tmp_path):
    off, motion = difference(tmp_path, *bent_bar({**SAME, **SIMILAR}[name]()))
    assert motion > 0.2 * SIZE[0]
    assert off < ALLOWED.get(name, 1e-3)


@pytest.mark.slow
@needs_calculix
@pytest.mark.parametrize(
    ("order", "formulation"), [(1, "displacement"), (2, "displacement")]
)
def test_calculix_with_nearly_incompressible_tets(order, formulation, tmp_path):
    """Without the mean change of volume, both lock alike."""
    body = bent_bar(incompressible(), order, formulation=formulation)
    off, _ = difference(tmp_path, *body)
    assert off < 1e-3


@pytest.mark.slow
@needs_calculix
def test_calculix_locks_where_we_do_not(tmp_path):
    """The reason that the note gives: C3D10 has no mean change of volume."""
    off, _ = difference(tmp_path, *bent_bar(incompressible()))
    assert 0.02 < off < 0.3


@pytest.mark.slow
@needs_calculix
@pytest.mark.parametrize(
    ("order", "pressure", "allowed"),
    [(1, 1.5e4, 1e-4), (2, 1.5e4, 5e-3), (2, 1.5e3, 5e-4)],
)
def test_calculix_inflates_a_cube_as_we_do(order, pressure, allowed, tmp_path):
    """Pressures follow the wall in both programs.

    On curved faces the product of area vector and shape functions is of degree 4, for
    which CalculiX has too few points: the difference falls with the curvature.
    """
    off, motion = difference(tmp_path, *inflated(order, isotropic(), pressure))
    assert motion > 1e-3
    assert off < allowed


@pytest.mark.slow
@needs_calculix
def test_calculix_on_elastic_supports(tmp_path):
    soft = Support("x_min", stiffness=2e8)
    rigid = difference(tmp_path, *bent_bar(isotropic()))
    elastic = difference(tmp_path, *bent_bar(isotropic(), supports=soft))
    assert elastic[0] < 1e-3
    assert elastic[1] > 1.02 * rigid[1]
