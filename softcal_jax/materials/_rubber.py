"""Rubbers: neo-Hookean, and the nearly incompressible ones of two invariants."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, is_traced
from softcal_jax.elements import cofactor, determinant, matmul
from softcal_jax.materials._constants import (
    MODULUS,
    POISSON,
    RATIO,
    Constant,
    as_field,
    check_constants,
    constant,
)
from softcal_jax.materials._elasticity import lame
from softcal_jax.materials._law import AbstractLaw, crossed, outer, paired


class NeoHookean(AbstractLaw):
    """Compressible neo-Hookean law.

    psi = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, I1 = F : F, J = det F
    (Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis,
    Eq. 6.27). Not defined for J <= 0, where it returns NaN and the solver steps back.

    Attributes:
        E: Young's modulus at small strain [Pa], one value or one per tet.
        nu: Poisson's ratio at small strain [-] in (-1, 0.5), one value or one per tet.
    """

    E: Constant = eqx.field(converter=as_field, metadata=MODULUS)
    nu: Constant = eqx.field(converter=as_field, metadata=RATIO)

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        lam, mu = lame(self.E, self.nu)
        log_J = jnp.log(determinant(F))
        return mu * (0.5 * (jnp.sum(F * F) - 3.0) - log_J) + 0.5 * lam * log_J**2

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress mu (F - F^-T) + lambda ln J F^-T [Pa]."""
        lam, mu = lame(self.E, self.nu)
        J = determinant(F)
        return mu * F + (lam * jnp.log(J) - mu) * (cofactor(F) / J)

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent mu I + lambda G(x)G + (mu - lambda ln J) G_iL G_kJ, G = F^-T [Pa]."""
        lam, mu = lame(self.E, self.nu)
        J = determinant(F)
        G = cofactor(F) / J
        across = (mu - lam * jnp.log(J)) * crossed(G, G)
        return mu * paired(jnp.eye(3), jnp.eye(3)) + lam * outer(G, G) + across


RUBBER_RATIO = constant(
    "", "Poisson's ratio at small strain: 0.499", within=(0.0, 0.5), kind=POISSON
)
INCOMPRESSIBLE = 0.499
"""Default of Poisson's ratio: 500 times as stiff against volume change as in shear."""


def signed(words: str):
    """Declare a stiffness that may be negative [Pa], see `constant`."""
    return constant("Pa", words, within=(-np.inf, np.inf))


_FIRST = signed('first stiffness: "40 kPa"')
_SECOND = signed('second stiffness: "5 kPa"')
_SOFTENING = signed('second stiffness: "-300 Pa"')
_STIFFENING = signed('third stiffness: "10 Pa"')


class AbstractRubber(AbstractLaw):
    """A law psi = W(F_iso) + K/4 (J^2 - 1 - 2 ln J) with F_iso = J^(-1/3) F.

    W costs the distortion alone (Flory, Trans. Faraday Soc. 57, 1961), the second term
    the change of volume (Simo and Taylor, Comput. Methods Appl. Mech. Eng. 85, 1991),
    with the bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu)). So at small strain it is
    Hooke's law of the shear modulus mu and Poisson's ratio nu, E = 2 mu (1 + nu).
    Not defined for J <= 0, where it returns NaN and the solver steps back. From nu =
    0.49 on, quadratic tets take the mean dilatation.
    """

    nu: eqx.AbstractVar[Constant]

    def __check_init__(self):
        check_constants(self)
        leaves = [getattr(self, name) for name in self.__dataclass_fields__]
        if any(map(is_traced, leaves)):
            return
        mu = np.atleast_1d(np.asarray(self.shear_modulus()))
        bad = mu[~((mu > 0.0) & np.isfinite(mu))]
        if bad.size:
            raise ValueError(
                f"these constants give the shear modulus {bad[0]:g} Pa at small "
                "strain; it must be positive and finite."
            )

    @abstractmethod
    def shear_modulus(self) -> Constant:
        """Shear modulus at small strain, mu [Pa]."""

    def bulk_modulus(self) -> Constant:
        """Bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu)) [Pa]."""
        ratio = 2.0 * (1.0 + self.nu) / (3.0 * (1.0 - 2.0 * self.nu))
        return self.shear_modulus() * ratio

    def volume_energy(self, J: Float[Array, ""]) -> Float[Array, ""]:
        """Energy K/4 (J^2 - 1 - 2 ln J) [J/m3]."""
        return 0.25 * self.bulk_modulus() * ((J - 1.0) * (J + 1.0) - 2.0 * jnp.log(J))

    def volume_stress(self, J: Float[Array, ""]) -> Float[Array, ""]:
        """Its derivative by ln J, K/2 (J^2 - 1) [Pa]; NaN for J <= 0."""
        stress = 0.5 * self.bulk_modulus() * (J - 1.0) * (J + 1.0)
        return jnp.where(J > 0.0, stress, jnp.nan)


class Distortion(NamedTuple):
    """Energy W of the distortion and its derivatives by the invariants i1 and i2 [Pa].

    Mixed derivatives are zero.
    """

    W: Float[Array, ""]
    W_1: Float[Array, ""]
    W_2: Float[Array, ""] | float = 0.0
    W_11: Float[Array, ""] | float = 0.0


class AbstractInvariantRubber(AbstractRubber):
    """A rubber whose W depends on i1 = J^(-2/3) I1 and linearly on i2 = J^(-4/3) I2.

    With C = F^T F, I1 = tr C, I2 = (I1^2 - C : C) / 2, G = F^-T and H = I1 F - F C,

        d i1 / dF = 2 J^(-2/3) (F - I1/3 G),   d i2 / dF = 2 J^(-4/3) (H - 2/3 I2 G)

    (Holzapfel, Nonlinear Solid Mechanics, 2000, Secs. 6.2 to 6.4).
    """

    @abstractmethod
    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W and its derivatives."""

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        s = _invariants(F)
        return self.distortion(s.a * s.I1, s.b * s.I2).W + self.volume_energy(s.J)

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """Stress P = W_1 di1/dF + W_2 di2/dF + K/2 (J^2 - 1) G [Pa]."""
        s = _invariants(F)
        w = self.distortion(s.a * s.I1, s.b * s.I2)
        return w.W_1 * s.d1 + w.W_2 * s.d2 + self.volume_stress(s.J) * s.G

    def tangent(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3 3 3"]:
        """Tangent, from the second derivatives of i1, i2 and J [Pa]."""
        s = _invariants(F)
        w = self.distortion(s.a * s.I1, s.b * s.I2)
        eye = jnp.eye(3)
        first, second = w.W_1 * s.a, w.W_2 * s.b
        volume = self.volume_stress(s.J)
        bulk = self.bulk_modulus() * s.J * s.J
        X = -4.0 / 3.0 * (first * F + 2.0 * second * s.H)
        inner = 2.0 / 9.0 * first * s.I1 + 8.0 / 9.0 * second * s.I2 + 0.5 * bulk
        X = X + inner * s.G
        turning = 2.0 / 3.0 * first * s.I1 + 4.0 / 3.0 * second * s.I2 - volume
        D = (2.0 * first + 2.0 * second * s.I1) * eye - 2.0 * second * s.C
        return (
            (outer(X, s.G) + outer(s.G, X))
            + turning * crossed(s.G, s.G)
            + paired(eye, D)
            + second * (4.0 * outer(F, F) - 2.0 * crossed(F, F))
            - 2.0 * second * paired(matmul(F, F.T), eye)
            + w.W_11 * outer(s.d1, s.d1)
        )


class _Invariants(NamedTuple):
    J: Float[Array, ""]
    I1: Float[Array, ""]
    I2: Float[Array, ""]
    a: Float[Array, ""]  # J^(-2/3)
    b: Float[Array, ""]  # J^(-4/3)
    C: Float[Array, "3 3"]
    G: Float[Array, "3 3"]
    H: Float[Array, "3 3"]
    d1: Float[Array, "3 3"]  # derivative of i1
    d2: Float[Array, "3 3"]  # derivative of i2


def _invariants(F: Float[Array, "3 3"]) -> _Invariants:
    J = determinant(F)
    G = cofactor(F) / J
    C = matmul(F.T, F)
    I1 = C[0, 0] + C[1, 1] + C[2, 2]
    I2 = 0.5 * (I1 * I1 - jnp.sum(C * C))
    a = 1.0 / jnp.cbrt(J * J)
    H = I1 * F - matmul(F, C)
    d1 = 2.0 * a * (F - I1 / 3.0 * G)
    d2 = 2.0 * a * a * (H - 2.0 / 3.0 * I2 * G)
    return _Invariants(J=J, I1=I1, I2=I2, a=a, b=a * a, C=C, G=G, H=H, d1=d1, d2=d2)


class MooneyRivlin(AbstractInvariantRubber):
    """Nearly incompressible Mooney-Rivlin law, for stretches up to about two.

        W = c10 (i1 - 3) + c01 (i2 - 3)

    (Mooney, J. Appl. Phys. 11, 1940; Rivlin, Phil. Trans. R. Soc. A 241, 1948), with
    the invariants and the change of volume of `AbstractRubber`. mu = 2 (c10 + c01). A
    bar that keeps its volume carries P = 2 (s - s^-2) (c10 + c01 / s).

    Attributes:
        c10: Half of the stiffness in shear by i1 [Pa].
        c01: Half of the stiffness in shear by i2 [Pa].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    c10: Constant = eqx.field(converter=as_field, metadata=_FIRST)
    c01: Constant = eqx.field(converter=as_field, metadata=_SECOND)
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
        return 2.0 * (self.c10 + self.c01)

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        W = self.c10 * (i1 - 3.0) + self.c01 * (i2 - 3.0)
        return Distortion(W, W_1=self.c10, W_2=self.c01)


class Yeoh(AbstractInvariantRubber):
    """Nearly incompressible Yeoh law: stiffens again at large stretch.

        W = c10 (i1 - 3) + c20 (i1 - 3)^2 + c30 (i1 - 3)^3

    (Yeoh, Rubber Chem. Technol. 66, 1993), with the invariant and the change of volume
    of `AbstractRubber`. mu = 2 c10. A bar that keeps its volume carries
    P = 2 (s - s^-2) (c10 + 2 c20 (i1 - 3) + 3 c30 (i1 - 3)^2), i1 = s^2 + 2 / s.

    Attributes:
        c10: Half of the shear modulus at small strain [Pa].
        c20: Softening (negative) at medium stretch [Pa].
        c30: Stiffening at large stretch [Pa].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    c10: Constant = eqx.field(converter=as_field, metadata=_FIRST)
    c20: Constant = eqx.field(converter=as_field, metadata=_SOFTENING)
    c30: Constant = eqx.field(converter=as_field, metadata=_STIFFENING)
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
        return 2.0 * self.c10

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        del i2
        x = i1 - 3.0
        return Distortion(
            ((self.c30 * x + self.c20) * x + self.c10) * x,
            W_1=(3.0 * self.c30 * x + 2.0 * self.c20) * x + self.c10,
            W_11=6.0 * self.c30 * x + 2.0 * self.c20,
        )


class Gent(AbstractInvariantRubber):
    """Nearly incompressible Gent law, which locks at a finite stretch.

        W = -mu J_m / 2 ln(1 - (i1 - 3) / J_m)

    (Gent, Rubber Chem. Technol. 69, 1996), with the invariant and the change of volume
    of `AbstractRubber`. A bar that keeps its volume carries
    P = mu (s - s^-2) J_m / (J_m - (i1 - 3)), i1 = s^2 + 2 / s. Not defined for
    i1 >= 3 + J_m: there it returns NaN, as for an inverted tet, so that the solver
    steps back; where no shape below the limit meets what is imposed, there is no
    equilibrium.

    Attributes:
        mu: Shear modulus at small strain [Pa].
        J_m: Limit of i1 - 3, where the chains are straight [-].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    mu: Constant = eqx.field(
        converter=as_field, metadata=constant("Pa", 'shear modulus: "90 kPa"')
    )
    J_m: Constant = eqx.field(
        converter=as_field,
        metadata=constant("", "limit of i1 - 3: 80", within=(0.0, jnp.inf)),
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def shear_modulus(self) -> Constant:
        return self.mu

    def distortion(self, i1: Float[Array, ""], i2: Float[Array, ""]) -> Distortion:
        """Compute W; NaN from the limit on, and so are its derivatives."""
        del i2
        used = (i1 - 3.0) / self.J_m
        # As a factor: the derivative of the logarithm is a number beyond the limit too.
        used = used * jnp.where(used < 1.0, 1.0, jnp.nan)
        room = 1.0 - used
        W_1 = 0.5 * self.mu / room
        return Distortion(
            -0.5 * self.mu * self.J_m * jnp.log1p(-used),
            W_1=W_1,
            W_11=W_1 / (room * self.J_m),
        )
