"""Which component of SOFA computes a law, and which laws have none."""

import inspect

import numpy as np
import pytest

import softcal_jax as sc
from softcal_jax.exchange.sofa import PluginElasticity, export_sofa
from softcal_jax.exchange.sofa._component import SCALES, component_of, law_for_sofa
from softcal_jax.materials import (
    ClassicalCorotational,
    Gent,
    MooneyRivlin,
    SofaCorotational,
    StVenantKirchhoff,
    TransverseIsotropic,
)
from softcal_jax.mesh import beam

MESH = beam(1.0, 1.0, 1.0, (1, 1, 1))
MM = SCALES["mm-kg-s"]
FIBRE = sc.Fibre(0.3)


def exported(law, choice="same", rotation="edge", release="v26.06"):
    sofa_law = law_for_sofa(law, MESH, choice=choice, rotation=rotation)
    return component_of(sofa_law, MESH.n_tets, release, MM)


def test_corotational_tets():
    component = exported(sc.Corotational(sc.Isotropic(2e5, 0.3)))
    assert component.component == "TetrahedronFEMForceField"
    assert component.data == {
        "method": "polar",
        "youngModulus": [200.0],  # kPa
        "poissonRatio": [0.3],
    }
    law = ClassicalCorotational(sc.Isotropic(2e5, 0.3))
    assert exported(law, rotation="large").data["method"] == "large"
    component = exported(law, rotation="procrustes")
    assert component.component == "CorotationalFEMForceField"
    assert component.data["template"] == "Vec3,Tetrahedron"
    with pytest.raises(ValueError, match=r"procrustes.* v26\.06; .* v25\.12"):
        exported(law, rotation="procrustes", release="v25.12")


def test_hyperelastic_laws():
    component = exported(sc.NeoHookean(3e5, 0.25))
    assert component.component == "TetrahedronHyperelasticityFEMForceField"
    assert component.data["materialName"] == "NeoHookean"
    # mu = E / 2.5 and lambda = E / 2.5 at nu = 1/4.
    np.testing.assert_allclose(component.data["ParameterSet"], [120.0, 120.0])
    component = exported(StVenantKirchhoff(sc.Isotropic(3e5, 0.25)))
    assert component.data["materialName"] == "StVenantKirchhoff"
    instead = exported(sc.NeoHookean(3e5, 0.25), choice="corotational")
    assert instead.data["youngModulus"] == [300.0]


def test_a_law_with_a_fibre_needs_the_plugin():
    full = TransverseIsotropic(7e5, 4e5, 0.3, 0.35, 2e5, FIBRE)
    component = exported(sc.Corotational(full))
    assert component.plugin == "Anisotropy"
    assert component.data["elasticitySymmetry"] == "transverseIsotropic"
    assert component.data["youngModulus"] == [700.0] * MESH.n_tets
    kind, E_l, nu_tl, mu = component.data["anisotropyParameters"][0]
    # The plugin overlooks mu_l; what is written is what it takes.
    assert (kind, E_l, nu_tl, mu) == (2.0, 400.0, 0.35, 700.0 / 2.6)
    np.testing.assert_allclose(
        component.data["anisotropyDirections"][-1], [np.cos(0.3), 0.0, np.sin(0.3)]
    )
    reduced = sc.ReducedTransverseIsotropic(4e5, 1e5, 0.3, FIBRE)
    component = exported(sc.Corotational(reduced))
    np.testing.assert_allclose(component.data["anisotropyParameters"][0][2], 0.6)
    with pytest.raises(ValueError, match=r"nu_tl is 0, .*Anisotropy"):
        exported(sc.Corotational(TransverseIsotropic(7e5, 4e5, 0.3, 0.0, 2e5, FIBRE)))


def test_the_plugin_is_isotropic_where_the_moduli_are():
    """Where E_t = E_l and both ratios are equal, its two deviations vanish."""
    equal = PluginElasticity(TransverseIsotropic(7e5, 7e5, 0.3, 0.3, 1.0, FIBRE))
    hooke = sc.Isotropic(7e5, 0.3)
    np.testing.assert_allclose(equal.tensor(), hooke.tensor(), rtol=0, atol=1e-8)


REFUSED = {
    "MooneyRivlin": (MooneyRivlin(4e4, 1e4), "MooneyRivlin .*another term .*calibrate"),
    "Gent": (Gent(4e4, 40.0), "Gent .*no such law.*calibrate"),
    "St. Venant with a fibre": (
        StVenantKirchhoff(sc.ReducedTransverseIsotropic(7e5, 4e5, 0.3, FIBRE)),
        "ReducedTransverse.* only .*Anisotropy",
    ),
    "field": (sc.NeoHookean(np.linspace(1e5, 2e5, 6), 0.3), "--law corotational"),
    "negative ratio": (sc.Corotational(sc.Isotropic(2e5, -0.1)), r"nu is -0\.1; SOFA"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_laws_without_a_counterpart_say_why(name):
    law, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        exported(law)


def test_only_the_law_of_sofa_is_written():
    law = law_for_sofa(
        sc.Corotational(sc.Isotropic(2e5, 0.3)), MESH, choice="same", rotation="edge"
    )
    assert isinstance(law, SofaCorotational)
    assert not law.conservative


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"release": "v24.12"}, r"unknown release 'v24\.12'"),
        ({"units": "mm"}, "unknown unit system 'mm'"),
        ({"law": "polar"}, "unknown law 'polar'"),
    ],
)
def test_unknown_options(tmp_path, option, message):
    unchecked = inspect.unwrap(export_sofa)  # without the type checker of the tests
    with pytest.raises(ValueError, match=message):
        unchecked(tmp_path / "results", tmp_path / "scene", **option)
