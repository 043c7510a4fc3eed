"""What a Lua interpreter makes of a script for IceSL, against fields in closed form."""

import csv
import json
from contextlib import contextmanager

import jax.numpy as jnp
import lupa.lua51
import meshio
import numpy as np
import pytest
from problems import FOAM_OF_THE_ROBOT
from wording import says

from benchmarks import _icesl
from benchmarks._icesl import RANGES, Slicer
from benchmarks._parallel_robot_geometry import merge
from softcal_jax import export_icesl
from softcal_jax.bodies import RigidBody
from softcal_jax.designs import (
    FoamTable,
    published_foam,
    read_foam_table,
    write_foam_table,
)
from softcal_jax.equilibrium import build_model
from softcal_jax.exchange.icesl import Design, _export, _settings
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import (
    Corotational,
    Fibre,
    FibreReinforced,
    NeoHookean,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import TetMesh, beam

SIZE = np.array([0.06, 0.03, 0.01])
STEP = 1.0 / 255.0

# {E_t, E_l [kPa], theta [degrees]} at two control points.
ROOT, TIP = (1200.0, 300.0, 20.0), (700.0, 150.0, -25.0)
PLACES = np.array([(0.0, 0.015, 0.005), (0.06, 0.0, 0.005)])


FINE, COARSE = 64, 16


@contextmanager
def voxels(n):
    """Fewer voxels than the slicer takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_icesl, "N", n)
        for module in (_export, _settings):
            patch.setattr(module, "N_VOXELS", n)
        yield


@pytest.fixture
def coarse():
    """Where voxels are not what is tested."""
    with voxels(COARSE):
        yield


def test_there_are_as_many_voxels_as_the_slicer_takes():
    assert {_icesl.N, *(m.N_VOXELS for m in (_export, _settings))} == {64}


def foam_model(
    E_t=1e6, E_l=3e5, theta=0.0, *, plane="xy", mesh=None, bodies=(), **fibre
):
    law = ReducedTransverseIsotropic(E_t, E_l, 0.3, Fibre(theta, plane=plane, **fibre))
    mesh = beam(*SIZE, (6, 3, 1)) if mesh is None else mesh
    return build_model(mesh, Corotational(law), density=400.0, bodies=bodies)


def centres(n):
    """Centres of n voxels along an edge of length one."""
    return (np.arange(n) + 0.5) / n


def two_points(region=None):
    points = ControlPoints({"root": PLACES[0], "tip": PLACES[1]})
    modulus = {"lower": 1e3, "upper": 1e8, "unit": "Pa", "region": region}
    E_t, E_l, theta = np.transpose([ROOT, TIP])
    angle = {"lower": -np.pi / 2, "upper": np.pi / 2, "unit": "rad", "region": region}
    return ParameterSpace(
        (
            ControlPointParameters("E_t", points, start=1e3 * E_t, **modulus),
            ControlPointParameters(
                "E_l", points, start=1e3 * E_l, interpolation="log", **modulus
            ),
            ControlPointParameters(
                "theta",
                points,
                start=np.deg2rad(theta),
                scale="linear",
                interpolation="director",
                **angle,
            ),
        )
    )


def write_start(directory, model, space):
    """Write a model with the start values of its parameters."""
    z = space.start()
    design = Design(space.model_at(model, z), space, z, "a beam")
    return export_icesl(design, directory)


def closed_form(places):
    """Inverse-distance weights of power 2, and what they mix, in kPa and degrees."""
    nearness = 1.0 / ((places[..., None, :] - PLACES) ** 2).sum(axis=-1)
    w = nearness / nearness.sum(axis=-1, keepdims=True)
    (E_t, E_l, theta) = np.transpose([ROOT, TIP])
    twice = np.deg2rad(2.0 * theta)
    mixed = np.arctan2(w @ np.sin(twice), w @ np.cos(twice))
    return w @ E_t, np.exp(w @ np.log(E_l)), np.rad2deg(0.5 * mixed)


def axis_apart(angle, other):
    """Angles between axes, which are the same after half a turn [degrees]."""
    return np.abs(np.mod(angle - other + 90.0, 180.0) - 90.0)


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """A field of two control points as Polyfoam, and what the slicer makes of it."""
    folder = tmp_path_factory.mktemp("graded") / "print"
    with voxels(FINE):
        written = write_start(folder, foam_model(), two_points())
        return written, Slicer(folder / "robot.lua")


@pytest.fixture(scope="module")
def wanted():
    """Settings by voxel of the field in closed form."""
    places = np.stack(np.meshgrid(*(centres(FINE),) * 3, indexing="ij"), axis=-1) * SIZE
    E_t, E_l, theta = closed_form(places)
    foam = published_foam().find(1e3 * E_l.ravel(), 1e3 * E_t.ravel())
    assert foam.error.max() < 1e-9
    shape = (FINE, FINE, FINE)
    return foam.density.reshape(shape), foam.anisotropy.reshape(shape), theta


def test_textures_read_back_give_the_field(graded, wanted):
    """At the centre of every voxel, to half a step of the 8 bits."""
    _, slicer = graded
    density, shrink, theta = wanted
    half = 0.5 * STEP + 1e-6
    read = slicer.values("infill_percentage_0")
    np.testing.assert_allclose(read, density, rtol=0.0, atol=half)
    read = slicer.values("kgon_x_shrink_0")
    np.testing.assert_allclose(read, shrink, rtol=0.0, atol=half)
    read = 360.0 * slicer.values("infill_angle_0")
    assert axis_apart(read, theta).max() < 360.0 * half


@pytest.mark.usefixtures("coarse")
def test_the_same_steps_where_textures_are_cut_off(tmp_path):
    """Whether the slicer keeps the nearest step or the next lower one."""
    written = write_start(tmp_path / "print", foam_model(), two_points())
    script = written.directory / "robot.lua"
    rounded, cut = Slicer(script), Slicer(script, stores="cut")
    assert set(cut.textures) == set(rounded.textures)
    assert len(cut.textures) == 3
    for name, texture in rounded.textures.items():
        np.testing.assert_array_equal(cut.textures[name].values, texture.values)


def test_the_angle_turns_without_a_jump(graded):
    """From 20 to -25 degrees through 0, which is 180: not by 135 the other way."""
    angle = 360.0 * graded[1].values("infill_angle_0")
    assert 40.0 < np.ptp(angle) < 46.5
    assert not any("jumps" in note for note in graded[0].notes)


def test_companion_settings(graded):
    written, slicer = graded
    assert slicer.settings == {
        "infill_type_0": "Polyfoam",
        "num_shells_0": 0,
        "cover_thickness_mm_0": 0,
        "print_perimeter_0": False,
        "pfoam_min_percentage_0": int(
            100 * slicer.values("infill_percentage_0").min() - 0.5
        ),
    }
    assert slicer.settings["pfoam_min_percentage_0"] < 20
    for texture in slicer.textures.values():
        np.testing.assert_allclose(texture.low, 0.0, atol=1e-5)
        np.testing.assert_allclose(texture.high, 1e3 * SIZE, rtol=1e-6)
    assert slicer.part == written.directory / "robot.stl"


def test_the_part_is_the_surface_in_mm(graded):
    surface = meshio.read(graded[0].directory / "robot.stl")
    a, b, c = surface.points[surface.cells[0].data].transpose(1, 0, 2)
    volume = np.sum(a * np.cross(b, c)) / 6.0
    np.testing.assert_allclose(volume, 60.0 * 30.0 * 10.0, rtol=1e-5)


def test_what_was_written_is_told(graded):
    written, slicer = graded
    about = json.loads((written.directory / "icesl.json").read_text())
    assert about["voxels"] == {
        "n": FINE, "filled": FINE**3, "beyond": 0, "tilted": 0, "across": 0
    }  # fmt: skip
    names = {path.name for path in written.directory.iterdir()} - {".softcal-files"}
    assert names == {"icesl.json", "robot.lua", "robot.stl", "foam.csv"}
    shown = {setting["name"]: setting for setting in about["settings"]}
    for name, texture in slicer.textures.items():
        setting, full = shown[name.removesuffix("_0")], RANGES[name]
        np.testing.assert_allclose(setting["lowest"], full * texture.values.min())
        np.testing.assert_allclose(setting["highest"], full * texture.values.max())
    # Half a step of 1/255 in the density alone is 1.6 % at 0.12, and E goes about
    # with its power of 1.1.
    assert 0.01 < written.rounding < 0.04
    (note,) = written.notes
    assert says(note, f"{100 * written.rounding:.2g} %")
    script = (written.directory / "robot.lua").read_text()
    assert script.startswith("-- a beam\n")
    assert says(script, "soft axis ... counter-clockwise")


def constant(tmp_path, *args, name="print", table=None, **options):
    """Settings of a body with the same material everywhere, and what was told."""
    model = foam_model(*args, **options.pop("fibre", {}))
    written = export_icesl(model, tmp_path / name, table=table, **options)
    return Slicer(written.directory / "robot.lua").settings, written


@pytest.mark.usefixtures("coarse")
def test_the_published_foam_in_both_conventions(tmp_path):
    """Its moduli are those of the density 0.150 at the shrink 0.2."""
    robot = FOAM_OF_THE_ROBOT
    moduli = (1e3 * robot.E_t, 1e3 * robot.E_l, np.deg2rad(30.0))
    soft, written = constant(tmp_path, *moduli)
    np.testing.assert_allclose(soft["infill_percentage_0"], 15.0, rtol=0.01)
    np.testing.assert_allclose(soft["kgon_x_shrink_0"], 0.2, rtol=0.01)
    np.testing.assert_allclose(soft["infill_angle_0"], 30.0)
    assert soft["pfoam_min_percentage_0"] == 14
    assert written.notes == ()
    stiff, _ = constant(tmp_path, *moduli, name="b", angle_marks="stiff")
    assert stiff == {**soft, "infill_angle_0": pytest.approx(120.0)}
    # The same foam, whose fibre is now its stiff axis: 90 degrees from the soft one.
    turned, written = constant(
        tmp_path, moduli[1], moduli[0], np.deg2rad(120.0), name="c"
    )
    assert turned == soft | {"infill_angle_0": pytest.approx(30.0)}
    assert written.n_across == written.n_voxels
    assert says(written.notes[0], "100 % ... E_l > E_t ... along the bed's z")
    rows = unreachable(written)
    assert len(rows) == COARSE**3
    (why,) = {row["why"] for row in rows}
    assert says(why, "right in ... plane only")


@pytest.mark.usefixtures("coarse")
def test_clockwise_and_offset(tmp_path):
    settings, _ = constant(
        tmp_path,
        1e6,
        3e5,
        np.deg2rad(20.0),
        clockwise=True,
        angle_offset=np.deg2rad(45.0),
    )
    np.testing.assert_allclose(settings["infill_angle_0"], 25.0)


def settings_of(written):
    """Settings by voxel, as shares of their ranges; the script holds the same."""
    voxels = np.argwhere(np.ones((COARSE,) * 3, bool))
    return {s.name: s.values(voxels).reshape((COARSE,) * 3) for s in written.settings}


def unreachable(written):
    with (written.directory / "unreachable.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("coarse")
def test_what_the_foam_does_not_reach_is_listed(tmp_path):
    """One half is too soft along the fibre: E_l below all that the table has."""
    mesh = beam(*SIZE, (6, 3, 1))
    right = mesh.centroids[:, 0] > 0.03
    E_l = np.where(right, 4e4, 3e5)
    written = export_icesl(foam_model(1e6, E_l, mesh=mesh), tmp_path / "print")
    rows = unreachable(written)
    assert len(rows) == written.n_beyond == COARSE**3 // 2
    x = np.array([float(row["x_mm"]) for row in rows])
    assert x.min() > 30.0
    i = np.array([int(row["i"]) for row in rows])
    np.testing.assert_allclose(x, 60.0 * (i + 0.5) / COARSE, atol=1e-4)
    row = rows[0]
    assert (float(row["E_t_kPa"]), float(row["E_l_kPa"])) == (1e3, 40.0)
    assert says(row["why"], "moduli beyond ... table")
    # The softest foams are those of the shrink 0.2.
    density = settings_of(written)["infill_percentage"][-1, 0, 0]
    given = published_foam().moduli(np.array([density]), np.array([0.2]))[0]
    given *= 1e-3
    np.testing.assert_allclose(float(row["nearest_E_l_kPa"]), given[0], rtol=0.03)
    np.testing.assert_allclose(float(row["nearest_E_t_kPa"]), given[1], rtol=0.03)
    (note, *_) = written.notes
    assert says(note, "50 % ... moduli ... (E_t, E_l) = (1, 0.04) MPa")
    script = (written.directory / "robot.lua").read_text()
    assert "-- 50 % of the part" in script


@pytest.mark.usefixtures("coarse")
def test_fields_per_tet_are_those_of_the_tet(tmp_path):
    """A designed field: each cell of the beam has a modulus of its own."""
    mesh = beam(*SIZE, (6, 3, 1))
    cell = np.floor(mesh.centroids[:, 0] / 0.01)
    E = 3e5 * 1.3**cell
    law = NeoHookean(jnp.asarray(E), 0.3)
    model = build_model(mesh, law, density=400.0)
    written = export_icesl(model, tmp_path / "print")
    read = settings_of(written)
    np.testing.assert_allclose(read["kgon_x_shrink"], 1.0, atol=1e-6)
    assert not read["infill_angle"].any()
    E = 3e5 * 1.3 ** np.floor(6 * centres(COARSE))
    density = published_foam().find(E, E).density
    wanted = np.broadcast_to(density[:, None, None], (COARSE,) * 3)
    np.testing.assert_allclose(
        read["infill_percentage"], wanted, rtol=0.0, atol=0.5 * STEP + 1e-6
    )


@pytest.mark.usefixtures("coarse")
def test_a_region_of_another_plane(tmp_path):
    """The upper of two sheets in xz is laid on the bed: y points down."""
    sheet = lambda y: beam(0.06, 0.01, 0.03, (6, 1, 3), origin=(0.0, y, 0.0))
    mesh = merge({"lower": sheet(-0.06), "upper": sheet(0.05)})
    ends = np.flatnonzero(mesh.points[:, 0] == 0.0)
    mesh = mesh.with_node_group("rod", ends)
    # In the lower sheet nothing could be printed.
    model = foam_model(
        np.where(np.arange(mesh.n_tets) < mesh.n_tets // 2, 1e9, 1e6),
        3e5,
        np.arctan2(mesh.centroids[:, 2], mesh.centroids[:, 0]),
        plane="xz",
        mesh=mesh,
        bodies=[RigidBody("rod", "rod")],
    )
    written = export_icesl(model, tmp_path / "print", region="upper")
    assert written.n_beyond == 0
    bed = json.loads((written.directory / "icesl.json").read_text())["bed"]
    assert bed["size_mm"] == pytest.approx([60.0, 30.0, 10.0])
    assert np.linalg.det(bed["rotation"]) == pytest.approx(1.0)
    top = np.array(bed["rotation"]) @ [0.0, 50.0, 0.0] + bed["shift_mm"]
    assert top[2] == pytest.approx(10.0)
    # Angles count from x to z of the mesh, which are x and y of the bed.
    angle = 360.0 * settings_of(written)["infill_angle"]
    at = centres(COARSE)
    x, z = np.meshgrid(60.0 * at, 30.0 * at, indexing="ij")
    off = axis_apart(angle[:, :, 8], np.rad2deg(np.arctan2(z, x)))
    assert np.median(off) < 4.0  # tets are 10 mm


@pytest.mark.usefixtures("coarse")
def test_a_parameter_of_one_region(tmp_path):
    """Control points act in their region; elsewhere the value of the model stays."""
    mesh = beam(*SIZE, (6, 3, 1))
    mesh = mesh.with_tet_group("root half", np.flatnonzero(mesh.centroids[:, 0] < 0.03))
    space = two_points("root half")
    model = foam_model(1e6, 3e5, 0.3, mesh=mesh)
    written = write_start(tmp_path / "print", model, space)
    angle = 360.0 * settings_of(written)["infill_angle"]
    assert axis_apart(angle[9:], np.rad2deg(0.3)).max() < 0.8
    places = (
        np.stack(np.meshgrid(*(centres(COARSE),) * 3, indexing="ij"), axis=-1) * SIZE
    )
    theta = closed_form(places[:7])[2]
    assert axis_apart(angle[:7], theta).max() < 0.8


@pytest.mark.usefixtures("coarse")
def test_outside_of_the_part_the_nearest_voxel_repeats(tmp_path):
    """A corner is missing in the box; a wall without voxel centres still counts."""
    mesh = beam(*SIZE, (6, 3, 2))
    x, _, z = mesh.centroids.T
    whole = np.flatnonzero((x < 0.03) | (z < 0.005))
    used, tets = np.unique(mesh.tets[whole], return_inverse=True)
    part = TetMesh(mesh.points[used], tets.reshape(-1, 4))
    E_t = 8e5 + 1e7 * part.centroids[:, 2]
    written = export_icesl(foam_model(E_t, 2e5, mesh=part), tmp_path / "print")
    assert written.n_voxels == COARSE**3 * 3 // 4
    density = settings_of(written)["infill_percentage"]
    np.testing.assert_array_equal(density[9:, :, 8:], density[9:, :, [7] * 8])


@pytest.mark.usefixtures("coarse")
def test_a_wall_thinner_than_the_voxels(tmp_path):
    """No voxel has its centre in the wall, and those that hold it have its moduli."""
    block = beam(0.06, 0.03, 0.01, (6, 3, 1))
    wall = beam(0.0002, 0.03, 0.01, (1, 3, 1), origin=(0.068, 0.0, 0.0))
    mesh = merge({"block": block, "wall": wall})
    x = mesh.points[:, 0]
    mesh = mesh.with_node_group("glue", np.flatnonzero((x == 0.06) | (x == 0.068)))
    E_t = np.where(mesh.centroids[:, 0] > 0.06, 1.5e6, 8e5)
    model = foam_model(E_t, 2e5, mesh=mesh, bodies=[RigidBody("glue", "glue")])
    density = settings_of(export_icesl(model, tmp_path / "print"))["infill_percentage"]
    thick, thin = (
        published_foam().find(np.array([2e5, 2e5]), np.array([8e5, 1.5e6])).density
    )
    np.testing.assert_allclose(density[:13], thick, atol=0.5 * STEP + 1e-6)
    np.testing.assert_allclose(density[15], thin, atol=0.5 * STEP + 1e-6)


def phasor():
    density = np.tile([0.1, 0.4], 2)
    soft = 12e6 * density**2
    stiff = soft * np.repeat([5.0, 1.0], 2)
    return FoamTable("Phasor", density, [0.0, 0.0, 1.0, 1.0], soft, stiff)


@pytest.mark.usefixtures("coarse")
def test_phasor_is_stiff_along_its_axis(tmp_path):
    """A stiff fibre 25 degrees out of the plane; iso 0.5 is stiff by sqrt(5)."""
    E_t = 12e6 * 0.2**2
    options = {"fibre": {"phi": np.deg2rad(25.0)}, "infill": "Phasor"}
    settings, written = constant(
        tmp_path, E_t, E_t * 5**0.5, np.deg2rad(200.0), table=phasor(), **options
    )
    assert settings["infill_type_0"] == "Phasor"
    np.testing.assert_allclose(settings["infill_percentage_0"], 20.0)
    np.testing.assert_allclose(settings["phasor_infill_iso_0"], 50.0)
    np.testing.assert_allclose(settings["phasor_infill_theta_0"], 20.0, rtol=1e-6)
    np.testing.assert_allclose(settings["phasor_infill_phi_0"], 25.0, rtol=1e-6)
    assert "pfoam_min_percentage_0" not in settings
    assert written.notes == ()


@pytest.mark.usefixtures("coarse")
def test_polyfoam_cannot_be_inclined(tmp_path):
    settings, written = constant(
        tmp_path, 1e6, 3e5, 0.0, fibre={"phi": np.deg2rad(25.0)}
    )
    assert written.n_tilted == COARSE**3 == len(unreachable(written))
    assert settings["infill_angle_0"] == 0.0
    assert says(written.notes[0], "100 % ... leaves the print plane ... Phasor")


@pytest.mark.usefixtures("coarse")
def test_an_axis_that_turns_all_the_way_round(tmp_path):
    """Around the middle every direction occurs: somewhere the angle must jump."""
    mesh = beam(0.03, 0.03, 0.01, (8, 8, 1))
    x, y, _ = (mesh.centroids - 0.015).T
    written = export_icesl(
        foam_model(1e6, 3e5, np.arctan2(y, x), mesh=mesh), tmp_path / "print"
    )
    assert says(written.notes[-1], "angle jumps by 180 degrees")


@pytest.mark.usefixtures("coarse")
def test_a_table_of_the_user(tmp_path):
    table = tmp_path / "mine.csv"
    table.write_text(
        "density;shrink;E_soft_MPa;E_stiff_MPa\n0,1;0,5;0,1;0,3\n0,4;0,5;1,6;4,8\n"
    )
    settings, _ = constant(tmp_path, 1.2e6, 4e5, table=table)
    np.testing.assert_allclose(settings["infill_percentage_0"], 20.0)
    np.testing.assert_allclose(settings["kgon_x_shrink_0"], 0.5)
    again = read_foam_table(tmp_path / "print" / "foam.csv", "Polyfoam")
    np.testing.assert_allclose(again.E_stiff, [3e5, 4.8e6])
    write_foam_table(tmp_path / "phasor.csv", phasor())
    read = read_foam_table(tmp_path / "phasor.csv", "Phasor")
    np.testing.assert_allclose(read.anisotropy, phasor().anisotropy)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("density,shrink,E_soft_kPa\n0.1,1,10\n", "'E_stiff_kPa' is missing"),
        ("density,iso,E_soft_kPa,E_stiff_kPa\n0.1,1,1,1\n", "'shrink' is missing"),
        (
            "density,shrink,E_soft_kPa,E_stiff_kPa\n0.1,1,10,10\n20,1,20,20\n",
            r"mine.csv: .*sample 2: density .*\(0, 1\]",
        ),
        (
            "density,shrink,E_soft_kPa,E_stiff_kPa\n0.1,1,,10\n",
            "sample 1: E_soft .* nan",
        ),
    ],
)
def test_bad_table_files(tmp_path, text, message):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_foam_table(path, "Polyfoam")


@pytest.mark.usefixtures("unchecked", "coarse")
def test_wrong_calls(tmp_path):
    model = foam_model()
    for options, message in (
        ({"infill": "Phasor"}, "Phasor.*give a table"),
        ({"table": phasor()}, "Phasor.*'Polyfoam'"),
        ({"infill": "Gyroid"}, "Polyfoam.*'Gyroid'"),
        ({"plane": "zx"}, "'zx'. .*Known: 'xy', 'xz', 'yz'"),
        ({"region": "arm"}, "tet group 'arm'"),
        ({"angle_marks": "hard"}, "'hard'. Known: 'soft', 'stiff'"),
    ):
        with pytest.raises(ValueError, match=message):
            export_icesl(model, tmp_path / "print", **options)
    law = FibreReinforced(NeoHookean(1e5, 0.45), 1e6, Fibre(0.0))
    threads = build_model(model.mesh, law, density=400.0)
    with pytest.raises(ValueError, match=r"FibreReinforced .*calibrate"):
        export_icesl(threads, tmp_path / "print")
    assert not (tmp_path / "print").exists()
    (tmp_path / "print").mkdir()
    (tmp_path / "print" / "mine.txt").touch()
    with pytest.raises(FileExistsError, match="is not empty"):
        export_icesl(model, tmp_path / "print")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("infill_percentage(3)", "unknown name infill_percentage"),
        ("set_setting_value('infill_percent_0', 20)", "unknown setting"),
        ("set_setting_value('infill_percentage_0', 120)", "infill_percentage_0 = 120"),
        ("set_setting_value('infill_type_0', 'Foam')", "infill_type_0 = 'Foam'"),
        ("set_setting_value('print_perimeter_0', 0)", "print_perimeter_0 = 0"),
        ("tex3d_r8f(32, 64, 64)", "textures are 64 x 64 x 64"),
        ("tex3d_r8f(64, 64, 64):set(64, 0, 0, v(0, 0, 0))", "indices go from 0 to 63"),
        ("tex3d_r8f(64, 64, 64):set(0, 0, 0, v(1.1, 0, 0))", "values from 0 to 1"),
        ("bbox(part):size()", "a box has no size"),
        ("part:scale(2)", "attempt to"),
        (
            "set_setting_value('infill_angle_0', tex3d_r8f(64, 64, 64))",
            "a texture needs two corners",
        ),
    ],
)
def test_the_slicer_is_strict(graded, tmp_path, line, message):
    """What the stand-in would accept silently would prove nothing."""
    stl = graded[0].directory / "robot.stl"
    script = tmp_path / "robot.lua"
    begin = f"local part = load('{stl}')\nemit(part, 0)\n"
    script.write_text(begin)
    Slicer(script)
    script.write_text(f"{begin}local x = 1 + 0\n{line}\n")
    with pytest.raises((ValueError, lupa.lua51.LuaError), match=message):
        Slicer(script)
