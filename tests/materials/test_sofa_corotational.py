"""The law of SOFA's tets, with its three rotations, against its forces in NumPy."""

from typing import Any

import equinox as eqx
import numpy as np
import pytest
from laws import ELASTICITIES, GRADIENTS, NU, E, stress, tangent
from problems import assert_second_order
from scipy.spatial.transform import Rotation

from benchmarks import _sofa_tets
from softcal_jax.materials import ClassicalCorotational, Isotropic, SofaCorotational
from softcal_jax.mesh import TetMesh, to_quadratic

KINDS = ("edge", "procrustes", "large")
each_kind = pytest.mark.parametrize("kind", KINDS)

# A tet that is far from regular, and the regular one.
CORNERS = np.array([[0.1, 0.0, 0.2], [1.3, 0.1, 0.0], [0.3, 0.6, 0.1], [0.2, 0.3, 1.9]])
REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])


def law_of(kind, elasticity, corners=CORNERS):
    mesh = TetMesh(corners, [[0, 1, 2, 3]])
    whole = SofaCorotational.of_mesh(mesh, elasticity, kind)
    return eqx.tree_at(lambda law: law.rest, whole, tuple(c[0] for c in whole.rest))


@each_kind
def test_stress_is_that_of_the_tets_of_sofa(kind):
    law, nodes = law_of(kind, Isotropic(E, NU)), np.array([[0, 1, 2, 3]])
    tet = _sofa_tets.tets(CORNERS, nodes, _sofa_tets.hooke(E, NU), kind)
    edges = (CORNERS[1:] - CORNERS[0]).T
    dN = np.linalg.inv(edges)
    for F in GRADIENTS:
        force = tet.force((CORNERS @ F.T)[None])[0]
        ours = np.linalg.det(edges) / 6 * dN @ stress(law, F).T
        np.testing.assert_allclose(ours, force[1:], rtol=0, atol=1e-13)


@each_kind
@pytest.mark.parametrize("name", ["isotropic", "full"])
def test_tangent_is_the_derivative_of_the_stress(kind, name):
    elasticity = Isotropic(E, NU) if name == "isotropic" else ELASTICITIES[name]
    law = law_of(kind, elasticity)
    P = lambda F: stress(law, F)
    for F, dF in zip(GRADIENTS[:3], GRADIENTS[3:], strict=True):
        dP = np.tensordot(tangent(law, F), dF, 2)
        assert_second_order(P, F, dF, dP, (1e-2, 1e-3), rtol=0.1)


@each_kind
def test_no_potential_and_it_says_so(kind):
    law = law_of(kind, Isotropic(E, NU))
    assert not law.conservative
    A = tangent(law, GRADIENTS[0])
    asymmetry = np.linalg.norm(A - A.transpose(2, 3, 0, 1)) / np.linalg.norm(A)
    assert asymmetry > 0.05


@each_kind
def test_turned_bodies_and_small_strains(kind):
    """P(Q F) = Q P(F), no stress where only turned, Hooke's tensor at rest."""
    law, elasticity = law_of(kind, ELASTICITIES["full"]), ELASTICITIES["full"]
    Q = Rotation.random(rng=4).as_matrix()
    for F in GRADIENTS:
        np.testing.assert_allclose(
            stress(law, Q @ F), Q @ stress(law, F), rtol=0, atol=1e-13
        )
    np.testing.assert_allclose(stress(law, Q), 0.0, atol=1e-14)
    C = elasticity.tensor()
    np.testing.assert_allclose(tangent(law, np.eye(3)), C, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", ["edge", "procrustes"])
def test_where_it_is_the_classical_law(kind):
    """Where L = I: on regular tets by Procrustes, on corners of a cube by edges.

    Elsewhere it is not, whatever the material.
    """
    cube = np.vstack([np.zeros(3), np.eye(3)])
    alike = law_of(kind, Isotropic(E, NU), {"edge": cube, "procrustes": REGULAR}[kind])
    classical, other = (
        ClassicalCorotational(Isotropic(E, NU)),
        law_of(kind, Isotropic(E, NU)),
    )
    for F in GRADIENTS:
        np.testing.assert_allclose(
            stress(alike, F), stress(classical, F), rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(
            tangent(alike, F), tangent(classical, F), rtol=0, atol=1e-13
        )
        assert np.max(np.abs(stress(other, F) - stress(classical, F))) > 1e-3


def test_the_order_of_the_nodes_matters_by_edges_alone():
    """Rotating the nodes of a tet keeps its volume, and changes which is the first."""
    F, order = GRADIENTS[0], [1, 0, 3, 2]
    off = {}
    for kind in KINDS:
        laws = (law_of(kind, Isotropic(E, NU), c) for c in (CORNERS, CORNERS[order]))
        one, other = (stress(law, F) for law in laws)
        off[kind] = float(np.max(np.abs(one - other)))
    assert off["procrustes"] < 1e-14
    assert min(off["edge"], off["large"]) > 1e-3


@pytest.mark.usefixtures("unchecked")
def test_quadratic_tets_and_unknown_rotations_are_refused():
    mesh = TetMesh(CORNERS, [[0, 1, 2, 3]])
    with pytest.raises(ValueError, match=r"mesh is quadratic.*to_linear"):
        SofaCorotational.of_mesh(to_quadratic(mesh), Isotropic(E, NU), "edge")
    polar: Any = "polar"
    with pytest.raises(ValueError, match=r"rotation 'polar'.* 'edge', 'large', "):
        SofaCorotational.of_mesh(mesh, Isotropic(E, NU), polar)
