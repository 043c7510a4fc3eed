"""Ogden's rubber, and powers of a symmetric, positive definite 3x3 tensor for it.

By the spectral form C^b = sum_i c_i^b N_i N_i^T. Its derivative in a direction dC is
V (D o (V^T dC V)) V^T, with the divided differences D_ij = (c_i^b - c_j^b)/(c_i - c_j)
(Daleckii and Krein 1951; Higham, Functions of Matrices, 2008, Theorem 3.11). Where
eigenvalues coincide, as at F = I, D_ij is the derivative b c_i^(b-1): it is written so
that the difference is never formed.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._module import if_any
from softcal_jax._typing import Array, Float
from softcal_jax.elements import cofactor, determinant, matmul, sum_of
from softcal_jax.materials._constants import Constant, as_field, constant
from softcal_jax.materials._rubber import (
    INCOMPRESSIBLE,
    RUBBER_RATIO,
    AbstractRubber,
    signed,
)

_SWEEPS = 5
"""Sweeps of Jacobi rotations; the error is squared with each, from the third on."""

_SMALL = 1e-2  # argument below which sinh x / x is taken from its series, to rounding


def _stiffness(term: str) -> dict[str, Any]:
    return signed(f'stiffness of the {term} term: "600 kPa"')


def _exponent(term: str) -> dict[str, Any]:
    return constant("", f"exponent of the {term} term: 1.3")


class Ogden(AbstractRubber):
    """Nearly incompressible Ogden law of one to three terms.

        W = sum_p mu_p / alpha_p (s_1^alpha_p + s_2^alpha_p + s_3^alpha_p - 3)

    in the principal stretches s_i of F_iso (Ogden, Proc. R. Soc. A 326, 1972), with the
    change of volume of `AbstractRubber`. mu = sum_p mu_p alpha_p / 2. (Some programs
    write 2 mu_p / alpha_p^2 for mu_p / alpha_p.) A bar that keeps its volume carries
    P = sum_p mu_p (s^(alpha_p - 1) - s^(-alpha_p / 2 - 1)).

    With C = F^T F, s_i^alpha is the eigenvalue of J^(-alpha/3) C^(alpha/2), so that
    P = sum_p mu_p J^(-alpha/3) (F C^(alpha/2 - 1) - tr(C^(alpha/2)) / 3 F^-T): powers
    of a tensor, whose derivatives are finite and exact where stretches coincide too.

    Attributes:
        mu_1: Stiffness of the first term [Pa]; mu_p alpha_p is usually positive.
        alpha_1: Its exponent [-], not zero.
        mu_2: Stiffness of the second term [Pa]; None without one.
        alpha_2: Its exponent [-].
        mu_3: Stiffness of the third term [Pa]; None without one.
        alpha_3: Its exponent [-].
        nu: Poisson's ratio at small strain [-] in (0, 0.5).
    """

    mu_1: Constant = eqx.field(converter=as_field, metadata=_stiffness("first"))
    alpha_1: Constant = eqx.field(converter=as_field, metadata=_exponent("first"))
    mu_2: Constant | None = eqx.field(
        converter=if_any(as_field), default=None, metadata=_stiffness("second")
    )
    alpha_2: Constant | None = eqx.field(
        converter=if_any(as_field), default=None, metadata=_exponent("second")
    )
    mu_3: Constant | None = eqx.field(
        converter=if_any(as_field), default=None, metadata=_stiffness("third")
    )
    alpha_3: Constant | None = eqx.field(
        converter=if_any(as_field), default=None, metadata=_exponent("third")
    )
    nu: Constant = eqx.field(
        converter=as_field, default=INCOMPRESSIBLE, metadata=RUBBER_RATIO
    )

    def __check_init__(self):
        for p in (2, 3):
            mu, alpha = getattr(self, f"mu_{p}"), getattr(self, f"alpha_{p}")
            if (mu is None) != (alpha is None):
                given = f"alpha_{p}" if mu is None else f"mu_{p}"
                raise ValueError(
                    f"term {p} has {given} alone; give mu_{p} and alpha_{p}, or "
                    "neither."
                )

    def terms(self) -> list[tuple[Constant, Constant]]:
        """Return stiffness and exponent of each term."""
        pairs = (
            (self.mu_1, self.alpha_1),
            (self.mu_2, self.alpha_2),
            (self.mu_3, self.alpha_3),
        )
        return [(m, a) for m, a in pairs if m is not None and a is not None]

    def shear_modulus(self) -> Constant:
        return 0.5 * sum_of(mu * alpha for mu, alpha in self.terms())

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        J, C = determinant(F), matmul(F.T, F)
        log_J = jnp.log(J)
        energy = self.volume_energy(J)
        for mu, alpha in self.terms():
            traced = jnp.exp(-alpha / 3.0 * log_J) * trace_of_power(C, 0.5 * alpha)
            energy += mu / alpha * (traced - 3.0)
        return energy

    def stress(self, F: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        """First Piola-Kirchhoff stress, term by term [Pa]."""
        J, C = determinant(F), matmul(F.T, F)
        G, log_J = cofactor(F) / J, jnp.log(J)
        stress = self.volume_stress(J) * G
        for mu, alpha in self.terms():
            M = power(C, 0.5 * alpha - 1.0)
            trace = jnp.sum(M * C)  # tr C^(alpha/2)
            term = matmul(F, M) - trace / 3.0 * G
            stress += mu * jnp.exp(-alpha / 3.0 * log_J) * term
        return stress


@jax.custom_jvp
def eigensystem(
    C: Float[Array, "3 3"],
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Compute eigenvalues, in no order, and eigenvectors (columns) by Jacobi rotations.

    Rotations keep their accuracy where eigenvalues (nearly) coincide, unlike the
    formulas of Cardano, and vectorise over tets, unlike a library routine.
    """

    def rotate(state, pair):
        A, V = state
        p, q = pair
        gap, off = A[q, q] - A[p, p], A[p, q]
        steep = jnp.abs(gap) + jnp.hypot(gap, 2.0 * off)
        sign = jnp.where(gap < 0.0, -2.0, 2.0)
        # Equal diagonal entries with a zero beside them need no rotation.
        t = jnp.where(steep > 0.0, sign * off / jnp.where(steep > 0.0, steep, 1.0), 0.0)
        c = 1.0 / jnp.sqrt(1.0 + t * t)
        s = t * c
        R = jnp.eye(3, dtype=A.dtype)
        R = R.at[p, p].set(c).at[q, q].set(c).at[p, q].set(s).at[q, p].set(-s)
        return matmul(R.T, matmul(A, R)), matmul(V, R)

    def sweep(_, state):
        for pair in ((0, 1), (0, 2), (1, 2)):
            state = rotate(state, pair)
        return state

    A, V = jax.lax.fori_loop(0, _SWEEPS, sweep, (C, jnp.eye(3, dtype=C.dtype)))
    return jnp.diag(A), V


@eigensystem.defjvp
def _no_derivative(primals, tangents):
    raise NotImplementedError(
        "Ogden has derivatives of its energy up to the second; a third one was asked "
        "for, which would differentiate eigenvectors."
    )


def _sinhc(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Compute sinh(x) / x, also at zero."""
    small = jnp.abs(x) < _SMALL
    safe = jnp.where(small, 1.0, x)
    y = x * x
    series = 1.0 + y / 6.0 * (1.0 + y / 20.0 * (1.0 + y / 42.0))
    return jnp.where(small, series, jnp.sinh(safe) / safe)


def divided_differences(
    c: Float[Array, "3"], b: Float[Array, ""]
) -> Float[Array, "3 3"]:
    """Compute (c_i^b - c_j^b) / (c_i - c_j), with the derivative where they coincide.

    With x = ln c and d = (x_i - x_j) / 2 it is b (c_i c_j)^((b-1)/2) sinhc(b d) /
    sinhc(d), in which nothing is subtracted but logarithms.
    """
    x = jnp.log(c)
    mean, half = 0.5 * (x[:, None] + x[None]), 0.5 * (x[:, None] - x[None])
    return b * jnp.exp((b - 1.0) * mean) * _sinhc(b * half) / _sinhc(half)


@jax.custom_jvp
def power(C: Float[Array, "3 3"], b: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Compute C^b."""
    c, V = eigensystem(C)
    return _assembled(c**b, V)


def _assembled(values: Float[Array, "3"], V: Float[Array, "3 3"]):
    return matmul(V * values[None, :], V.T)


@power.defjvp
def _power_jvp(primals, tangents):
    (C, b), (dC, db) = primals, tangents
    c, V = eigensystem(C)
    inner = matmul(V.T, matmul(dC, V))
    values = c**b
    dM = matmul(V, matmul(divided_differences(c, b) * inner, V.T))
    return _assembled(values, V), dM + db * _assembled(values * jnp.log(c), V)


@jax.custom_jvp
def trace_of_power(C: Float[Array, "3 3"], a: Float[Array, ""]) -> Float[Array, ""]:
    """Compute tr C^a."""
    c, _ = eigensystem(C)
    return jnp.sum(c**a)


@trace_of_power.defjvp
def _trace_jvp(primals, tangents):
    (C, a), (dC, da) = primals, tangents
    # By `power`, whose own rule gives the second derivative.
    slope = a * jnp.sum(power(C, a - 1.0) * dC)
    return trace_of_power(C, a), slope + da * _trace_of_log(C, a)


@jax.custom_jvp
def _trace_of_log(C: Float[Array, "3 3"], a: Float[Array, ""]) -> Float[Array, ""]:
    """Compute tr(C^a ln C), the derivative of tr C^a by a."""
    c, _ = eigensystem(C)
    return jnp.sum(c**a * jnp.log(c))


@_trace_of_log.defjvp
def _trace_of_log_jvp(primals, tangents):
    (C, a), (dC, da) = primals, tangents
    c, V = eigensystem(C)
    log = jnp.log(c)
    slope = _assembled(c ** (a - 1.0) * (1.0 + a * log), V)
    second = jnp.sum(c**a * log * log)
    return jnp.sum(c**a * log), jnp.sum(slope * dC) + da * second
