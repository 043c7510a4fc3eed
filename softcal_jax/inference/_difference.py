"""Do two robots give the same values? The posterior of one as the prior of the other.

A prior contradicts the data or does not: the difference d of both estimates against its
covariance, by d^T (C_A + C_B)^-1 d (chi-squared; Evans and Moshonov, Bayesian Anal. 1,
2006, on conflicts of prior and data). Errors that both share, like that of the same nu,
count in both covariances, which makes the check more lenient.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc

from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference._least_squares import RANK
from softcal_jax.inference._uncertainty import UNLIKELY


class Estimate(NamedTuple):
    """Parameters, z and its covariance, and whether the data contradict the model."""

    space: ParameterSpace
    z: Float[Array | HostArray, " n_p"]
    covariance: Float[HostArray, "n_p n_p"]
    contradicted: bool = False


class Difference(Module):
    """What robot A gave for the material beside what robot B gave, in SI.

    Attributes:
        names: The parameters of the material that both have estimated.
        units: Their units.
        of_a: Values from A.
        of_b: Values from B.
        std_a: Their standard errors from A, by all causes.
        std_b: Those from B.
        chi_squared: Of all differences together [-].
        directions: Number of independent differences: fewer than parameters where some
            of these vary together without a rest.
        worst: Change from A to B along the direction in which they differ most.
        worst_size: Its size in standard errors [-].
        contradicted: Robots of which the model contradicts the data: "A", "B".
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    of_a: Float[HostArray, " n"]
    of_b: Float[HostArray, " n"]
    std_a: Float[HostArray, " n"]
    std_b: Float[HostArray, " n"]
    chi_squared: float
    directions: int
    worst: Float[HostArray, " n"]
    worst_size: float
    contradicted: tuple[str, ...]

    @property
    def unseen(self) -> Float[HostArray, " n"]:
        """Differences that would hardly be seen: two standard errors."""
        return 2.0 * np.hypot(self.std_a, self.std_b)

    @property
    def probability(self) -> float:
        """Probability of differences as large, if both are of one material [-]."""
        return float(chdtrc(self.directions, self.chi_squared))

    @property
    def agree(self) -> bool:
        """Whether both agree within their errors, and each with its own data."""
        return self.probability >= UNLIKELY and not self.contradicted


def difference(a: Estimate, b: Estimate) -> Difference:
    """Compare what two robots give for the parameters of the material, by their names.

    Parameters of the setup belong to one experiment each, whatever their names.

    Raises:
        ValueError: If no parameter of the material has a standard error in both.
    """
    rows = [_known(estimate) for estimate in (a, b)]
    names = [name for name in rows[1] if name in rows[0]]
    if not names:
        raise ValueError(
            "no parameter of the material has a standard error in both: A has "
            f"{listed(a.space.names)}, and B has {listed(b.space.names)}. Calibrate "
            "the same law, with parameters of the same names."
        )
    of_a, of_b = ([row[name] for name in names] for row in rows)
    value_a, value_b = (e.space.from_scaled(jnp.asarray(e.z)) for e in (a, b))
    z = b.space.to_scaled(value_b.at[np.array(of_b)].set(value_a[np.array(of_a)]))
    d = np.asarray(b.space.shorter(jnp.asarray(b.z) - z))[of_b]
    slopes = b.space.slopes(z)[of_b]
    unit = a.space.slopes(a.z)[of_a] / slopes
    C_a = a.covariance[np.ix_(of_a, of_a)] * np.outer(unit, unit)
    C_b = b.covariance[np.ix_(of_b, of_b)]
    apart = np.sqrt(np.diag(C_a + C_b))  # each alone
    size, Q = np.linalg.eigh((C_a + C_b) / np.outer(apart, apart))
    size, Q = size[size > RANK**2 * size[-1]], Q[:, size > RANK**2 * size[-1]]
    along = Q.T @ (d / apart)
    most = int(np.argmax(np.abs(along) / np.sqrt(size)))
    std = lambda e: e.space.slopes(e.z) * np.sqrt(np.diag(e.covariance))
    return Difference(
        names=tuple(names),
        units=tuple(b.space.parameters[i].unit for i in of_b),
        of_a=np.asarray(value_a)[of_a],
        of_b=np.asarray(value_b)[of_b],
        std_a=std(a)[of_a],
        std_b=std(b)[of_b],
        chi_squared=float(np.sum(along**2 / size)),
        directions=len(size),
        worst=slopes * apart * Q[:, most] * along[most],
        worst_size=float(abs(along[most]) / np.sqrt(size[most])),
        contradicted=tuple(name for name, e in (("A", a), ("B", b)) if e.contradicted),
    )


def _known(estimate: Estimate) -> dict[str, int]:
    """Index the parameters of the material that have a standard error, by name."""
    space = estimate.space
    known = np.isfinite(np.diag(estimate.covariance)) & np.array(space.sets_fields)
    return {space.names[i]: i for i in np.flatnonzero(known).tolist()}
