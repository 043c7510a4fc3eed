"""Transverse isotropy, one fibre axis: elasticity at small strain, a law for large."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.elements import cofactor, determinant, matmul
from softcal_jax.materials._constants import (
    ACROSS,
    ALONG,
    CONTRACTION,
    PLANE_RATIO,
    POISSON,
    RATIO,
    SHEAR,
    Constant,
    as_field,
    check_constants,
    check_ratio,
    constant,
)
from softcal_jax.materials._elasticity import AbstractElasticity, TabulatedElasticity
from softcal_jax.materials._fibre import Fibre
from softcal_jax.materials._law import AbstractLaw, crossed, outer, paired


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
    pair = jnp.outer(u, a)
    pressure = k.lam * trace + k.mixed * e
    return 2.0 * k.mu * strain + pressure * jnp.eye(3) + pair + pair.T


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

        def limits(E_t, E_l, nu_t):
            limit = np.sqrt((1.0 - nu_t) * E_t / (2.0 * E_l))
            return -limit, limit

        check_ratio(self, "nu_tl", ("E_t", "E_l", "nu_t"), limits)

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


class _Modes(NamedTuple):
    """Strain measures of the law and their first derivatives in F [-]."""

    I4: Float[Array, ""]
    a: Float[Array, ""]  # ln of the fibre stretch
    w: Float[Array, ""]  # ln of the area of its section
    z: Float[Array, ""]  # one over this area
    section: Float[Array, ""]  # (I1 - I5/I4) / 2
    f: Float[Array, "3"]  # F u
    q: Float[Array, "3"]  # C u
    h: Float[Array, "3"]  # F^-T u
    G: Float[Array, "3 3"]  # F^-T, derivative of ln J
    da: Float[Array, "3 3"]
    dw: Float[Array, "3 3"]
    e: Float[Array, "3 3"]  # derivative of I5 over 2 I4
    b: Float[Array, "3 3"]  # minus half the derivative of h . h
    d_section: Float[Array, "3 3"]


def _modes(F: Float[Array, "3 3"], u: Float[Array, "3"]) -> _Modes:
    J = determinant(F)
    G = cofactor(F) / J
    f = jnp.sum(F * u[None, :], axis=1)
    h = jnp.sum(G * u[None, :], axis=1)
    q = jnp.sum(F * f[:, None], axis=0)
    I4, I5 = jnp.sum(f * f), jnp.sum(q * q)
    a = 0.5 * jnp.log(I4)
    da = jnp.outer(f / I4, u)
    e = (jnp.outer(f, q) + jnp.outer(jnp.sum(F * q[None, :], axis=1), u)) / I4
    return _Modes(
        I4=I4,
        a=a,
        w=jnp.log(J) - a,
        z=jnp.sqrt(I4) / J,
        section=0.5 * (jnp.sum(F * F) - I5 / I4),
        f=f,
        q=q,
        h=h,
        G=G,
        da=da,
        dw=G - da,
        e=e,
        b=jnp.outer(h, jnp.sum(G * h[:, None], axis=0)),
        d_section=F - e + I5 / I4 * da,
    )


class TransverseHyperelastic(AbstractLaw):
    """Large-strain law with one fibre axis; energy in four uncoupled strain modes.

    With the fibre stretch l = sqrt(I4), a = ln l, the area of the section across the
    fibre w = ln(J / l), I4 = u . C u, I5 = u . C^2 u and C = F^T F,

        psi = C33/2 a^2 + C13 a w + (C11 + C12)/4 w^2      stretch and area
              + mu_l/2 (I4 (u . C^-1 u) - 1)               shear along the fibre
              + mu_t ((I1 - I5/I4) l / (2 J) - 1)          shear across the fibre

    in the modes of Criscione, Douglas and Hunter (J. Mech. Phys. Solids 49, 2001) with
    the fibre invariants of Blemker, Pinsky and Delp (J. Biomech. 38, 2005). Deviations:
    the shear along the fibre is tan^2 of the angle between the fibre and the normal of
    its section instead of I5/I4^2 - 1 (equal at small strain), so that both simple
    shears have the energy mu_l gamma^2/2; the shear across is taken without arccosh.

    The small-strain limit is `TransverseIsotropic` with nu_t = nu_tl = nu, stiffnesses
    C_ij included. No line of psi is negative for a stable set of constants, whether the
    fibre is the soft or the stiff axis. (The law of Bonet and Burton, Comput. Methods
    Appl. Mech. Eng. 162, 1998, loses its strength where a soft fibre is stretched.)
    With E_t = E_l it is isotropic at small strain only. A bar under tension along the
    fibre carries P = E_l ln(l) / l, with its maximum at l = e. Not defined for J <= 0,
    where it returns NaN and the solver steps back.

    Attributes:
        E_t: Young's modulus across the fibre at small strain [Pa].
        E_l: Young's modulus along the fibre at small strain [Pa].
        nu: Poisson's ratio for stress across the fibre, the same in the transverse
            plane and along the fibre [-]; -1 < nu and 1 - nu - 2 nu^2 E_l/E_t > 0.
        mu_l: Shear modulus along the fibre [Pa].
        fibre: Direction of the fibre in the rest shape.
    """

    E_t: Constant = eqx.field(converter=as_field, metadata=ACROSS)
    E_l: Constant = eqx.field(converter=as_field, metadata=ALONG)
    nu: Constant = eqx.field(
        converter=as_field,
        metadata=constant("", "Poisson's ratio: 0.499", kind=POISSON),
    )
    mu_l: Constant = eqx.field(converter=as_field, metadata=SHEAR)
    fibre: Fibre

    def __check_init__(self):
        check_constants(self)

        def limits(E_t, E_l):  # the roots of 1 - nu - 2 n nu^2, and |nu_t| < 1
            n = E_l / E_t
            root = np.sqrt(1.0 + 8.0 * n)
            return np.maximum(-1.0, -(1.0 + root) / (4.0 * n)), 2.0 / (1.0 + root)

        check_ratio(self, "nu", ("E_t", "E_l"), limits)

    def _constants(self) -> tuple[PlaneStiffness, Float[Array, ""]]:
        C = plane_stiffness(self.E_t, self.E_l, self.nu, self.nu)
        return C, self.E_t / (2.0 * (1.0 + self.nu))

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        C, mu_t = self._constants()
        s = _modes(F, self.fibre.direction())
        return (
            0.5 * C.C33 * s.a * s.a
            + C.C13 * s.a * s.w
            + 0.25 * (C.C11 + C.C12) * s.w * s.w
            + 0.5 * self.mu_l * (s.I4 * jnp.sum(s.h * s.h) - 1.0)
            + mu_t * (s.section * s.z - 1.0)
        )

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress, mode by mode [Pa]."""
        C, mu_t = self._constants()
        s = _modes(F, self.fibre.direction())
        along = C.C33 * s.a + C.C13 * s.w
        area = C.C13 * s.a + 0.5 * (C.C11 + C.C12) * s.w
        shear_along = s.I4 * (jnp.sum(s.h * s.h) * s.da - s.b)
        shear_across = s.z * (s.d_section - s.section * s.dw)
        normal = along * s.da + area * s.dw
        return normal + self.mu_l * shear_along + mu_t * shear_across

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent, from the second derivatives of I4, I5, J and u . C^-1 u [Pa].

        d2a = (u u) I / I4 - 2 da da, d2(ln J) = -G_iL G_kJ with G = F^-T.
        """
        C, mu_t = self._constants()
        u = self.fibre.direction()
        s = _Modes(*jax.lax.optimization_barrier(_modes(F, u)))
        eye = jnp.eye(3)
        C_w = 0.5 * (C.C11 + C.C12)
        along, area = C.C33 * s.a + C.C13 * s.w, C.C13 * s.a + C_w * s.w
        m, k = mu_t * s.z, self.mu_l * s.I4
        I5_I4 = jnp.sum(s.q * s.q) / s.I4
        second_G = m * s.section - area  # factor of -d2(ln J)
        second_a = along + second_G  # factor of d2a

        X_a = (0.5 * C.C33 - second_a - 2.0 * m * I5_I4) * s.da
        X_a = X_a + C.C13 * s.dw + 2.0 * m * s.e - 2.0 * k * s.b
        X_w = 0.5 * (C_w + m * s.section) * s.dw - m * s.d_section
        X_G = 0.5 * second_G * s.G + k * s.b
        uu, uq = jnp.outer(u, u), jnp.outer(u, s.q)
        normal = (second_a + m * I5_I4) / s.I4 + self.mu_l * jnp.sum(s.h * s.h)
        D = m * (eye - (uq + uq.T) / s.I4) + normal * uu
        X_a, X_w, X_G, D = jax.lax.optimization_barrier((X_a, X_w, X_G, D))
        return (
            (outer(s.da, X_a) + outer(X_a, s.da))
            + (outer(s.dw, X_w) + outer(X_w, s.dw))
            + (crossed(s.G, X_G) + crossed(X_G, s.G))
            - m * (crossed(F, s.da) + crossed(s.da, F))
            + paired(eye, D)
            - m / s.I4 * paired(matmul(F, F.T), uu)
            - m / s.I4 * paired(jnp.outer(s.f, s.f), eye)
            + k * paired(jnp.outer(s.h, s.h), matmul(s.G.T, s.G))
        )
