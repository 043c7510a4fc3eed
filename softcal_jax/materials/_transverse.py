"""Linear elasticity with one fibre axis (transverse isotropy)."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.materials._constants import (
    ACROSS,
    ALONG,
    CONTRACTION,
    PLANE_RATIO,
    RATIO,
    SHEAR,
    Constant,
    as_field,
    check_constants,
    check_fibre_ratio,
    constant,
)
from softcal_jax.materials._elasticity import AbstractElasticity, TabulatedElasticity
from softcal_jax.materials._fibre import Fibre


class PlaneStiffness(NamedTuple):
    """Stiffnesses of normal strains, with the fibre along axis 3 [Pa]."""

    C11: Float[Array, ""]
    C12: Float[Array, ""]
    C13: Float[Array, ""]
    C33: Float[Array, ""]


def plane_stiffness(
    E_t: Float[Array, ""],
    E_l: Float[Array, ""],
    nu_t: Float[Array, ""],
    nu_tl: Float[Array, ""],
) -> PlaneStiffness:
    """Invert the compliance of moduli [Pa] and ratios [-] of `TransverseIsotropic`.

    S11 = 1/E_t, S12 = -nu_t/E_t, S13 = -nu_tl/E_t, S33 = 1/E_l.
    """
    coupling = nu_tl * nu_tl * E_l / E_t
    m = 1.0 - nu_t - 2.0 * coupling
    across = E_t / (m * (1.0 + nu_t))
    return PlaneStiffness(
        C11=across * (1.0 - coupling),
        C12=across * (nu_t + coupling),
        C13=E_l * nu_tl / m,
        C33=E_l * (1.0 - nu_t) / m,
    )


class _Coefficients(NamedTuple):
    """Coefficients of the invariants of psi [Pa], with v = strain u and e = u . v.

    psi = lam/2 tr^2 + mu strain : strain + shear v . v + mixed tr e + along/2 e^2.
    """

    lam: Float[Array, ""]
    mu: Float[Array, ""]
    shear: Float[Array, ""]
    mixed: Float[Array, ""]
    along: Float[Array, ""]


def _stress(
    strain: Float[Array, "3 3"], u: Float[Array, "3"], k: _Coefficients
) -> Float[Array, "3 3"]:
    """Compute the gradient of psi of `_Coefficients` for a symmetric strain [Pa]."""
    v = jnp.sum(strain * u[None, :], axis=1)
    e = jnp.sum(u * v)
    trace = strain[0, 0] + strain[1, 1] + strain[2, 2]
    # u v^T + v u^T + (...) u u^T as one symmetric pair of outer products.
    a = k.shear * v + 0.5 * (k.mixed * trace + k.along * e) * u
    outer = u[:, None] * a[None, :]
    pressure = k.lam * trace + k.mixed * e
    return 2.0 * k.mu * strain + pressure * jnp.eye(3) + outer + outer.T


class TransverseIsotropic(AbstractElasticity):
    """Transversely isotropic elasticity by its five engineering constants.

    Compliance with axis 3 along the fibre: S11 = S22 = 1/E_t, S33 = 1/E_l,
    S12 = -nu_t/E_t, S13 = S23 = -nu_tl/E_t, S44 = S55 = 1/mu_l, S66 = 2 (1+nu_t)/E_t.
    nu_ab is the contraction along b for stress along a, so nu_lt = nu_tl E_l/E_t.
    The stress is written in the invariants of strain and fibre (Spencer, Continuum
    Theory of the Mechanics of Fibre-Reinforced Composites, 1984), without rotating
    tensors. In the paper the fibre is the soft axis, E_l < E_t.

    Attributes:
        E_t: Young's modulus across the fibre [Pa], one value or one per tet.
        E_l: Young's modulus along the fibre [Pa], one value or one per tet.
        nu_t: Poisson's ratio in the transverse plane [-] in (-1, 1).
        nu_tl: Contraction along the fibre for stress across it [-], with
            nu_tl^2 < (1 - nu_t) E_t / (2 E_l).
        mu_l: Shear modulus along the fibre [Pa].
        fibre: Direction of the fibre in the rest shape.
    """

    E_t: Constant = eqx.field(converter=as_field, metadata=ACROSS)
    E_l: Constant = eqx.field(converter=as_field, metadata=ALONG)
    nu_t: Constant = eqx.field(converter=as_field, metadata=PLANE_RATIO)
    nu_tl: Constant = eqx.field(
        converter=as_field,
        metadata=constant(
            "",
            "contraction along the fibre for stress across it: 0.3",
            kind=CONTRACTION,
        ),
    )
    mu_l: Constant = eqx.field(converter=as_field, metadata=SHEAR)
    fibre: Fibre

    def __check_init__(self):
        check_constants(self)
        check_fibre_ratio(self.E_t, self.E_l, self.nu_t, self.nu_tl)

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        C = plane_stiffness(self.E_t, self.E_l, self.nu_t, self.nu_tl)
        mu = self.E_t / (2.0 * (1.0 + self.nu_t))
        mixed = C.C13 - C.C12
        coefficients = _Coefficients(
            lam=C.C12,
            mu=mu,
            shear=2.0 * (self.mu_l - mu),
            mixed=mixed,
            along=C.C33 - C.C12 + 2.0 * mu - 4.0 * self.mu_l - 2.0 * mixed,
        )
        return _stress(strain, self.fibre.direction(), coefficients)

    def tabulated(self) -> TabulatedElasticity:
        return TabulatedElasticity.of(self)


class ReducedTransverseIsotropic(AbstractElasticity):
    """Transverse isotropy of two moduli and one ratio, stable for every pair of moduli.

    With B = sqrt(E_t) I + (sqrt(E_l) - sqrt(E_t)) u u^T,

        sigma = (B strain B + nu / (1 - 2 nu) (B : strain) B) / (1 + nu),

    which is nu_ij = nu sqrt(E_i/E_j), mu_ij = sqrt(E_i E_j) / (2 (1 + nu)): Li and
    Barbic, "Stable Orthotropic Materials", SCA 2014, reference [13] of the paper. It
    is the isotropic law where E_t = E_l. Shear along the fibre is tied to the moduli;
    where it matters take `TransverseIsotropic`.

    Attributes:
        E_t: Young's modulus across the fibre [Pa], one value or one per tet.
        E_l: Young's modulus along the fibre [Pa], one value or one per tet.
        nu: Poisson's ratio [-] in (-1, 0.5), one value or one per tet.
        fibre: Direction of the fibre in the rest shape.
    """

    E_t: Constant = eqx.field(converter=as_field, metadata=ACROSS)
    E_l: Constant = eqx.field(converter=as_field, metadata=ALONG)
    nu: Constant = eqx.field(converter=as_field, metadata=RATIO)
    fibre: Fibre

    def __check_init__(self):
        check_constants(self)

    def stress(self, strain: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        root_t = jnp.sqrt(self.E_t)
        step = jnp.sqrt(self.E_l) - root_t  # B = root_t I + step u u^T
        ratio = self.nu / (1.0 - 2.0 * self.nu)
        scale = 1.0 / (1.0 + self.nu)
        coefficients = _Coefficients(
            lam=scale * ratio * self.E_t,
            mu=0.5 * scale * self.E_t,
            shear=scale * root_t * step,
            mixed=scale * ratio * root_t * step,
            along=scale * (1.0 + ratio) * step * step,
        )
        return _stress(strain, self.fibre.direction(), coefficients)

    def tabulated(self) -> TabulatedElasticity:
        return TabulatedElasticity.of(self)
