"""Directions of fibres that a project file gives by a formula."""

from pathlib import Path

import meshio
import numpy as np
import pytest
from small_project import write_small_project
from wording import says

from softcal_jax.materials import FibreReinforced, Yeoh
from softcal_jax.mesh import beam
from softcal_jax.project import ProjectError, load_project

E_F = 'field = "E_f"\nlower = "1 MPa"\nupper = "50 MPa"'
FIELD = 'field = "E"\nlower = "100 kPa"\nupper = "1 MPa"'
BODY = 'beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }'
GROUPS = """\
[groups.x_min]
plane = { point = "(0, 0, 0) mm", normal = [1, 0, 0] }

[groups.x_max]
of = "faces"
plane = { point = "(60, 0, 0) mm", normal = [1, 0, 0] }

[groups.tip]
"""
AXIS = 'axis = "x", through = "(0, 10, 10) mm"'


def project_of(folder, material, *changes):
    """A silicone beam with fibres, of which the modulus is calibrated."""
    law = (
        'law = "fibre-reinforced"\nE = "264 kPa"\nnu = 0.499\nE_f = "20 MPa"\n'
        f"{material}\n"
    )
    small = ('law = "neo-hookean"\nE = "200 kPa"\nnu = 0.3\n', law)
    return write_small_project(folder, small, *(changes or ((FIELD, E_F),)))


def fibres(path):
    """Centroids from the long axis [m], and the direction in each tet."""
    model = load_project(path).model
    away = model.mesh.centroids - [0.0, 0.01, 0.01]
    u = np.asarray(model.law.fibre.direction())
    u = np.broadcast_to(u.reshape(3, -1), (3, model.n_tets)).T
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1.0, rtol=1e-14)
    return away, u


def test_hoop(tmp_path):
    away, u = fibres(project_of(tmp_path, f'directions = {{ type = "hoop", {AXIS} }}'))
    np.testing.assert_allclose(u[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.sum(u * away, axis=1), 0.0, atol=1e-15)


def test_helix_of_two_families(tmp_path):
    """Both at the angle theta from the axis, and normal to the radius."""
    path = project_of(
        tmp_path,
        f'directions = {{ type = "helix", {AXIS} }}\ntheta = "54.7 deg"\nfamilies = 2',
        (FIELD, 'field = "theta"\nlower = "30 deg"\nupper = "80 deg"'),
    )
    away, u = fibres(path)
    angle = np.deg2rad(54.7)
    np.testing.assert_allclose(u[:, 0], np.cos(angle), rtol=1e-14)
    away[:, 0] = 0.0
    np.testing.assert_allclose(np.sum(u * away, axis=1), 0.0, atol=1e-15)
    project = load_project(path)
    assert project.model.law.families == 2
    (theta,) = project.parameters
    np.testing.assert_allclose(float(theta.start), angle, rtol=1e-14)
    other = np.asarray(project.model.law.fibre.mirrored().direction()).T
    np.testing.assert_allclose(other[:, 0], u[:, 0], rtol=1e-14)
    np.testing.assert_allclose(other[:, 1:], -u[:, 1:], rtol=0, atol=1e-15)


def test_the_page_on_laws_has_wound_silicone(tmp_path):
    """Its [material], with a group "wall" and the axis of this beam."""
    page = Path(__file__).parents[2] / "docs/guide/element-and-law.md"
    shown = (
        page.read_text().split("<!-- fragment: wound -->\n```toml\n")[1].split("```")[0]
    )
    shown = shown.replace('axis = "z", through = "(0, 0, 0) mm"', AXIS)
    wall = (
        '[groups.wall]\nof = "tets"\nbox = { lower = "(30, 0, 0) mm", upper = '
        '"(60, 20, 20) mm" }\n\n[markers]\n'
    )
    material = (
        '[material]\nlaw = "neo-hookean"\nE = "200 kPa"\nnu = 0.3\ndensity = '
        '"1 g/cm^3"\n'
    )
    path = write_small_project(
        tmp_path,
        (material, shown),
        (FIELD, f'{E_F}\nregion = "wall"'),
        ("[markers]\n", wall),
    )
    law = load_project(path).model.law
    assert isinstance(law, FibreReinforced)
    assert isinstance(law.matrix, Yeoh)
    assert (law.families, law.tension_only) == (2, True)
    np.testing.assert_allclose(np.unique(law.E_f), [0.0, 20e6], rtol=1e-12)


def test_a_region_has_its_own(tmp_path):
    groups = (
        '[groups.half]\nof = "tets"\nbox = { lower = "(30, 0, 0) mm", upper = '
        '"(60, 20, 20) mm" }\n[material.regions.half]\nE_f = "5 MPa"\n'
        f'directions = {{ type = "hoop", {AXIS} }}\n\n[markers]\n'
    )
    path = project_of(
        tmp_path,
        'directions = { type = "along", axis = "z" }\ntension_only = true',
        (FIELD, f'{E_F}\nregion = "half"'),
        ("[markers]\n", groups),
    )
    away, u = fibres(path)
    model = load_project(path).model
    half = model.mesh.tets_of("half")
    others = np.setdiff1d(np.arange(model.n_tets), half)
    assert len(others)
    assert len(half)
    np.testing.assert_allclose(u[others], [[0, 0, 1]] * len(others), atol=1e-15)
    np.testing.assert_allclose(np.sum(u * away, axis=1)[half], 0.0, atol=1e-15)
    np.testing.assert_allclose(model.law.E_f[half], 5e6)
    np.testing.assert_allclose(model.law.E_f[others], 20e6)
    assert model.law.tension_only


def with_vectors(folder, vectors, **names):
    """A project whose mesh is a file with a cell array."""
    mesh = beam(0.06, 0.02, 0.02, (3, 1, 1))
    raw = meshio.Mesh(
        1e3 * mesh.points,
        [("tetra", mesh.tets)],
        cell_data={"fibre": [vectors(mesh)]},
    )
    folder.mkdir(exist_ok=True)
    raw.write(folder / "body.vtu")
    return project_of(
        folder,
        f'directions = {{ type = "cells", array = "{names.get("array", "fibre")}" }}',
        (BODY, 'file = "body.vtu"\nlength_unit = "mm"'),
        ("[groups.tip]\n", GROUPS),
        (FIELD, E_F),
    )


def test_from_the_mesh_file(tmp_path):
    """A vector field, of which only the direction counts."""
    wavy = lambda mesh: np.stack(
        [np.ones(mesh.n_tets), 50 * mesh.centroids[:, 0], 0 * mesh.centroids[:, 0]], 1
    )
    away, u = fibres(with_vectors(tmp_path, wavy))
    np.testing.assert_allclose(u[:, 1] / u[:, 0], 50 * away[:, 0], rtol=1e-6)
    np.testing.assert_allclose(u[:, 2], 0.0, atol=1e-15)


def refusal(path):
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ("", "material.theta: missing ... angle"),
        (
            'directions = { type = "helix", axis = "x" }',
            "material.theta: missing ... angle",
        ),
        (
            'directions = { type = "spiral", axis = "x" }',
            'material.directions.type: got "spiral" ... "along", "hoop", "helix", '
            '"cells"',
        ),
        (
            'directions = { type = "hoop" }',
            'material.directions.axis: missing ... "z"',
        ),
        (
            'directions = { type = "along", axis = "x", through = "(0, 0, 0) mm" }',
            "material.directions.through: unknown key ... axis",
        ),
        (
            'directions = { type = "cells", array = "fibre" }',
            "material.directions: ... no mesh file ... 'fibre'",
        ),
        (
            'theta = "0 deg"\nfamilies = 3',
            "material.families: got 3; expected",
        ),
        (
            'theta = "0 deg"\ntension_only = 1',
            "material.tension_only: got 1 ... true or false",
        ),
        (
            'theta = "0 deg"\nmatrix = "transverse-hyperelastic"',
            'material.matrix: got "transverse-hyperelastic" ... "neo-hookean"',
        ),
        (
            'theta = "0 deg"\nE_t = "1 MPa"',
            'material.E_t: ... "transverse-isotropic" ... '
            '"reduced-transverse-isotropic" ... "transverse-hyperelastic"',
        ),
        (
            'theta = "0 deg"\nelasticity = "isotropic"',
            'material.elasticity: ... "corotational"',
        ),
    ],
)
def test_what_is_refused(tmp_path, material, message):
    said = refusal(project_of(tmp_path, material))
    assert says(said.split("\n- "), message)


def test_a_helix_around_a_centroid_is_refused(tmp_path):
    path = project_of(tmp_path, 'directions = { type = "hoop", axis = "z" }')
    where = load_project(path).model.mesh.centroids[4] * 1e3
    through = f"({float(where[0])!r}, {float(where[1])!r}, 0) mm"
    path = project_of(
        tmp_path / "on_axis",
        f'directions = {{ type = "hoop", axis = "z", through = "{through}" }}',
    )
    said = refusal(path)
    assert says(said, "material.directions: 1 of 18 ... centroid")


def test_bad_arrays(tmp_path):
    ones = lambda mesh: np.ones((mesh.n_tets, 3))
    said = refusal(with_vectors(tmp_path / "a", ones, array="fiber"))
    assert says(said, "'fiber' ... mean 'fibre'")
    zero = lambda mesh: (
        np.ones((mesh.n_tets, 3)) * (np.arange(mesh.n_tets) != 7)[:, None]
    )
    said = refusal(with_vectors(tmp_path / "b", zero))
    assert says(said, "material.directions: ... [0.0, 0.0, 0.0]")
