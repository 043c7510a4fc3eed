"""The view in `report.html`: what it holds is what was found, and it says what not."""

import base64
import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_fit, make_result, make_simulation_result, small_model
from robot_project import write_robot_project
from test_page import DATA, check_page
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import build_model, tet_states
from softcal_jax.fields import field_standard_errors
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import tessellate
from softcal_jax.project import load_project
from softcal_jax.results import _view, _write, write_results, write_vtu
from softcal_jax.results._view import body_view
from softcal_jax.results._view_data import (
    Field,
    calibrated_field,
    robot_data,
    state_fields,
    surface_of,
    view_data,
    view_fields,
)

NONE = 65535
"""What stands for no value."""

pytestmark = pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")


@pytest.fixture(autouse=True)
def no_opengl(monkeypatch):
    """The browser draws the view: the machine that writes it needs nothing for that."""
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")


def fits_of(model):
    """A fitted configuration, and a held-out one that moves half as far."""
    first = make_fit(model.mesh)
    other = make_fit(model.mesh, "held out", "validation", (0.0, 0.002, 0.0))
    return first, dataclasses.replace(other, displacement=0.5 * first.displacement)


def fields_of(model, shown, surface):
    """The fields of a simulation."""
    states = [state_fields(model, fit) for fit in shown]
    return view_fields(model, shown, states, surface, None)


def read(folder):
    """The page, and the data of its view."""
    page = check_page(folder)
    return page, json.loads(page.scripts[page.of("script").index(DATA)])


def unpacked(text, kind="<u2"):
    return np.frombuffer(base64.b64decode(text), kind)


def positions(data, text):
    """Positions in mm, by the rule that `_view_data` states."""
    return data["low"] + data["step"] * unpacked(text).reshape(-1, 3)


def check_values(field, k, expected):
    """Compare values of a configuration, to half a step, with nan for none."""
    low, high = field["range"]
    raw = unpacked(field["values"][k]).astype(float)
    values = np.where(raw == NONE, np.nan, low + (high - low) * raw / (NONE - 1))
    half = 0.5 * (high - low) / (NONE - 1) + 1e-9 * abs(high)
    np.testing.assert_allclose(values, expected, rtol=0, atol=half)


@pytest.mark.parametrize("order", [1, 2])
def test_positions_and_fields_are_those_of_the_results(tmp_path, order):
    model = small_model(order=order)
    result = make_result(model=model, fits=fits_of(model))
    write_results(result, tmp_path / "out")
    _, data = read(tmp_path / "out")
    cut, tets = tessellate(model.mesh), surface_of(model, 4).tets
    fields = {field["label"]: field for field in data["fields"]}
    rest = 1e3 * cut.interpolate(model.mesh.points)
    close = {"rtol": 0, "atol": 0.5 * data["step"] + 1e-9}
    assert data["step"] < 1e-4 * np.ptp(rest)  # far below what a screen shows
    np.testing.assert_allclose(positions(data, data["rest"]), rest, **close)
    triangles = unpacked(data["triangles"]).reshape(-1, 3)
    assert np.array_equal(triangles, cut.triangles)
    for k, fit in enumerate(result.configurations):
        shown = data["configurations"][k]
        u = 1e3 * cut.interpolate(fit.displacement)
        assert shown["drawn"]
        np.testing.assert_allclose(positions(data, shown["points"]), rest + u, **close)
        check_values(fields["displacement [mm]"], k, np.linalg.norm(u, axis=1))
        distances = 1e3 * np.linalg.norm(fit.error_after, axis=1)
        check_values(fields["distance at markers [mm]"], k, distances)
        for marker, point in zip(shown["markers"], fit.points, strict=True):
            assert marker["name"] == point.name
            for key in ("measured", "simulated"):
                np.testing.assert_allclose(marker[key], 1e3 * getattr(point, key))
        states = tet_states(model, jnp.asarray(fit.displacement))
        sigma = states.cauchy[tets]
        # Another way to the same: the differences of the principal stresses.
        a, b, c = np.linalg.eigvalsh(sigma).T
        mises = np.sqrt(0.5 * ((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2))
        check_values(fields["von Mises stress [kPa]"], k, 1e-3 * mises)
        C = np.einsum("eqki,eqkj->eqij", states.F, states.F)[tets]
        stretch = np.sqrt(np.linalg.eigvalsh(C)[..., -1]).mean(axis=1)
        check_values(fields["largest principal stretch [-]"], k, stretch)
    E = np.asarray(model.law.E)[tets]
    check_values(fields["E [kPa]"], 0, 1e-3 * E)


def test_standard_errors_are_shares_and_missing_ones_are_grey():
    model = small_model()
    errors = {"E": np.full(model.n_tets, 4e3)}
    errors["E"][:10] = np.nan
    data = data_of(body_view(make_result(model=model, fits=fits_of(model)), errors))
    (field,) = (f for f in data["fields"] if f["label"].startswith("standard"))
    tets = surface_of(model, 4).tets
    assert field["label"] == "standard error of E [%]"
    assert field["note"].endswith("Grey: no value.")
    check_values(field, 0, 100.0 * (errors["E"] / np.asarray(model.law.E))[tets])


def options(page, name):
    """Values of a choice, which is inside its label."""
    place = [attrs.get("id") for _, attrs in page.elements].index(f"view-{name}")
    assert page.elements[place][0] == "select"
    assert page.elements[place - 1][0] == "label"
    values = []
    for tag, attrs in page.elements[place + 1 :]:
        if tag != "option":
            break
        values.append(attrs["value"])
    return values


def test_every_configuration_and_field_is_offered_and_labelled(tmp_path):
    model = small_model()
    result = make_result(model=model, fits=fits_of(model))
    write_results(result, tmp_path / "out")
    page, data = read(tmp_path / "out")
    assert options(page, "configuration") == ["0", "1"]
    assert options(page, "field") == [str(k) for k in range(len(data["fields"]))]
    labels = [field["label"] for field in data["fields"]]
    assert labels == [
        "displacement [mm]",
        "E [kPa]",
        "standard error of E [%]",
        "nu [-]",  # it ended on a bound, and has no standard error
        "largest principal stretch [-]",
        "von Mises stress [kPa]",
        "distance at markers [mm]",
    ]
    for text in [*labels, "droop (fitted)", "held out (held out)"]:
        assert text in page.texts
    assert says(page.text, "held out (held out):", "8.00 mm", "2.00 mm", "10.0 %")
    (area,) = (canvas for canvas in page.of("canvas") if canvas["id"] == "view-area")
    assert area["tabindex"] == "0"
    assert area["aria-label"]
    ids = {attrs["id"] for _, attrs in page.elements if "id" in attrs}
    assert set(area["aria-describedby"].split()) <= ids
    assert all(button["aria-label"] for button in page.of("button"))
    names = {box["id"].removeprefix("view-") for box in page.of("input")}
    assert names == {"mesh", "rest", "markers", "names"}
    # Nothing of it shows before the script has found that it can draw.
    (view,) = (figure for figure in page.of("figure") if figure.get("id") == "view")
    assert "hidden" in view


@pytest.mark.parametrize(("E", "first"), [([2e5, 2e5], 0), ([2e5, 3e5], 1)])
def test_a_calibrated_field_colours_the_body_at_first(E, first):
    """If it varies over the body; else the displacement."""
    of = lambda label, values: Field(label, "", "face", (np.array(values),))
    fields = [of("displacement [mm]", [0.0, 1.0]), of("E [kPa]", E)]
    fields += [of("standard error of E [%]", [1.0, 2.0]), of("nu [-]", [0.1, 0.3])]
    assert calibrated_field(fields) == first


def test_without_an_equilibrium_nothing_looks_like_one(tmp_path):
    """The body stays at rest, without a value, and words say why."""
    model = small_model()
    result = make_simulation_result(model)
    write_results(result, tmp_path / "out")
    page, data = read(tmp_path / "out")
    good, bad = data["configurations"]
    assert good["drawn"]
    assert not bad["drawn"]
    assert bad["points"] == data["rest"] != good["points"]
    assert [m["simulated"] for m in bad["markers"]] == []
    for field in data["fields"]:
        assert field["values"][0] is not None
        assert field["values"][1:] in ([], [None])
    assert "lane 1 - no equilibrium" in page.texts
    words = [p for p in page.of("p") if p.get("class") == "stop"]
    assert len(words) == 1
    assert says(page.text, "lane 1: no equilibrium ... inverted")
    assert says(page.text, "drawn at rest")
    write_results(make_simulation_result(model, (False,)), tmp_path / "none")
    page = check_page(tmp_path / "none")
    assert not page.of("canvas")
    assert says(page.text, "no configuration ... equilibrium")


def test_a_calibration_that_did_not_converge_says_so_above_its_view(tmp_path):
    for converged in (True, False):
        folder = tmp_path / str(converged)
        write_results(make_result(converged=converged), folder)
        page, _ = read(folder)
        said = any(text.startswith("NOT CONVERGED:") for text in page.texts)
        assert said != converged


def test_no_view_where_no_pictures_are_wanted(tmp_path):
    write_results(make_result(), tmp_path / "out", pictures=None)
    page = check_page(tmp_path / "out")
    assert not page.of("script")
    assert not page.of("canvas")


def test_what_is_too_large_is_coarser_or_left_out_and_said(monkeypatch):
    model = small_model(order=2)
    result = make_result(model=model, fits=fits_of(model))
    whole = body_view(result, None)
    most = len(json.dumps(data_of(whole), separators=(",", ":")))
    assert "keep the page small" not in whole.content

    monkeypatch.setattr(_view, "MOST_DATA", most - 1)
    coarse = body_view(result, None)
    assert says(coarse.content, "coarsely ... page small")
    data = data_of(coarse)
    assert len(unpacked(data["triangles"])) * 4 == len(
        unpacked(data_of(whole)["triangles"])
    )
    assert len(data["configurations"]) == 2
    assert coarse.names == {"droop", "held out"}

    monkeypatch.setattr(_view, "MOST_DATA", 1)
    none = body_view(result, None)
    n = len(surface_of(model, 1).faces)
    assert says(none.content, f"{n} faces ... too large")
    assert not none.script
    assert not none.names

    alone = make_result(model=model, fits=fits_of(model)[:1])
    monkeypatch.setattr(_view, "PARTS", 1)
    monkeypatch.setattr(_view, "MOST_DATA", 10**9)
    most = len(json.dumps(data_of(body_view(alone, None)), separators=(",", ":")))
    monkeypatch.setattr(_view, "MOST_DATA", most + 100)
    first = body_view(result, None)
    assert says(first.content, "page small: held out")
    assert first.names == {"droop"}
    assert len(data_of(first)["configurations"]) == 1


def data_of(view):
    """The data in the content of a view."""
    text = view.content.partition('id="view-data">')[2].partition("</script>")[0]
    return json.loads(text)


def test_writing_it_compiles_nothing_beside_the_bodies(tmp_path):
    """A page should not cost more than what is written anyway."""
    model = small_model(order=2)
    result = make_result(model=model, fits=fits_of(model))
    estimate = result.space, result.z, result.budget.covariance
    errors = field_standard_errors(model, *estimate)
    for fit in result.configurations:
        path = tmp_path / "body.vtu"
        write_vtu(path, model, fit.displacement, standard_errors=errors)
    with Compilations() as compiled:
        body_view(result, errors)
    assert compiled.programs == []


def test_edges_of_a_box_are_sharp():
    """Its twelve edges, cut as often as the faces, and no others."""
    for order in (1, 2):
        mesh = small_model(order=order).mesh
        surface = surface_of(small_model(order=order), 4)
        points = surface.cut.interpolate(mesh.points)
        sharp = surface.edges[: surface.n_sharp]
        np.testing.assert_allclose(length_of(points, sharp), 4 * (0.1 + 0.02 + 0.02))
        # All sides of the triangles of the mesh, none within a face.
        faces = tessellate(mesh, parts=1).triangles
        sides = {
            tuple(sorted(face[[i, j]]))
            for face in faces
            for i, j in ((0, 1), (1, 2), (0, 2))
        }
        corners = tessellate(mesh, parts=1).interpolate(mesh.points)
        whole = length_of(corners, np.array(list(sides)))
        np.testing.assert_allclose(length_of(points, surface.edges), whole)


def length_of(points, edges):
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).sum()


def test_fibres_move_with_the_material():
    """Under a linear map of the body, its fibres are mapped as well."""
    law = Corotational(ReducedTransverseIsotropic(5e5, 2e5, 0.3, Fibre(0.35)))
    model = build_model(small_model().mesh, law, density=1000.0)
    A = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.3], [0.05, 0.0, 1.2]])
    X = model.mesh.points
    still = dataclasses.replace(make_fit(model.mesh), displacement=np.zeros_like(X))
    moved = dataclasses.replace(still, displacement=X @ A.T - X)
    surface = surface_of(model, 4)
    shown = [still, moved]
    data = view_data(model, shown, surface, fields_of(model, shown, surface))
    rest, after = (
        positions(data, pose["fibres"]).reshape(-1, 2, 3)
        for pose in data["configurations"]
    )
    np.testing.assert_allclose(after, rest @ A.T, atol=4 * data["step"])
    along = rest[:, 1] - rest[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    fibre = [np.cos(0.35), 0.0, np.sin(0.35)]
    np.testing.assert_allclose(along, np.tile(fibre, (len(along), 1)), atol=2e-3)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A robot with actuators of most kinds, at rest and solved."""
    path = write_robot_project(tmp_path_factory.mktemp("robot"))
    project = load_project(path)
    return project.simulate()[0]


def test_actuators_and_frames(robot):
    """Each with its name and what drives it, where the pictures have it."""
    for pose in robot.configurations:
        data = robot_data(robot.model, pose)
        if not pose.converged:
            assert not any(data[key] for key in ("cables", "frames", "motors"))
            continue
        assert pose.robot is not None
        (cable,) = data["cables"]
        assert cable["name"].startswith("left: ")
        (motor,) = data["motors"]
        bodies = {b.name: 1e3 * b.position for b in pose.robot.bodies}
        np.testing.assert_allclose(motor["at"], bodies["arm"], atol=1e-3)
        frames = [f for f in data["frames"] if f["kind"] == "frame of a rigid body"]
        assert {f["name"] for f in frames} == set(bodies)
        for frame in frames:
            np.testing.assert_allclose(frame["at"], bodies[frame["name"]], atol=1e-3)
            R = np.array(frame["axes"])
            np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6)


def test_rigid_faces_have_no_value_of_the_law(robot):
    surface = surface_of(robot.model, 4)
    assert surface.rigid.any()
    assert not surface.rigid.all()
    x = robot.model.mesh.points[surface.faces][:, :, 0]
    ends = np.all(np.isclose(x, 0.0), axis=1) | np.all(np.isclose(x, 0.06), axis=1)
    assert np.array_equal(surface.rigid, ends)
    fields = fields_of(robot.model, robot.configurations, surface)
    for field in fields:
        for values in field.values if field.place == "face" else ():
            if values is not None:
                assert np.array_equal(np.isnan(values), surface.rigid)


def test_loads_and_gravity_point_where_they_act():
    model = small_model()
    posed = Configuration("hung", "x_min", gravity=(0.0, 0.0, -9.81))
    fit = dataclasses.replace(make_fit(model.mesh), posed=posed)
    assert robot_data(model, fit)["gravity"] == [0.0, 0.0, -1.0]
    assert robot_data(model, make_fit(model.mesh))["gravity"] is None
