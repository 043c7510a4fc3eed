"""Signal to noise of what is known and of candidate configurations."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import ParameterSpace
from softcal_jax.identifiability._gains import Gain, Unranked
from softcal_jax.identifiability._spread import (
    WEAK_BELOW,
    posterior,
    prior_std,
    si_slope,
)
from softcal_jax.identifiability._survey import (
    AnyVector,
    Parameters,
    Sensed,
    as_sequence,
    survey,
)


class Prospects(eqx.Module):
    """What is known, and what candidates would add, as signal to noise.

    Attributes:
        space: The parameters.
        z: Where they were taken [-].
        known: Of the configurations that are there, stacked, per prior std [-].
        candidates: Of each candidate that has an equilibrium, by name.
        unranked: The other candidates.
    """

    space: ParameterSpace
    z: Float[HostArray, " n_p"]
    known: Float[HostArray, "n_e n_p"]
    candidates: dict[str, Float[HostArray, "_ n_p"]]
    unranked: tuple[Unranked, ...]

    def with_measured(self, name: str) -> "Prospects":
        """A candidate counted among what is known."""
        known = np.concatenate([self.known, self.candidates[name]])
        rest = {k: G for k, G in self.candidates.items() if k != name}
        return Prospects(self.space, self.z, known, rest, self.unranked)

    def gain(self, name: str) -> Gain:
        """What a candidate adds to what is known."""
        before = self.known
        after = np.concatenate([before, self.candidates[name]])
        spreads = [np.sqrt(np.diag(posterior(G))) for G in (before, after)]
        best = int(np.argmax(spreads[0] - spreads[1]))
        parameter = self.space.parameters[best]
        prior = (si_slope(self.space, self.z) * prior_std(self.space))[best]
        value = np.asarray(self.space.from_scaled(jnp.asarray(self.z)))[best]
        old, new = (information_eigenvalues(G) for G in (before, after))
        return Gain(
            name,
            float(np.sum(np.log(new)) - np.sum(np.log(old))),
            float(new[-1] - old[-1]),
            blind_count(after),
            parameter.name,
            float(prior * spreads[0][best]),
            float(prior * spreads[1][best]),
            float(value),
            parameter.unit,
        )


def information_eigenvalues(
    G: Float[HostArray, "n_e n_p"],
) -> Float[HostArray, " n_p"]:
    """Eigenvalues of M = I + G^T G, falling; not formed, for its condition [-]."""
    singular = np.linalg.svd(G, compute_uv=False)
    return 1.0 + np.pad(singular, (0, G.shape[1] - len(singular))) ** 2


def blind_count(G: Float[HostArray, "n_e n_p"]) -> int:
    """Directions whose spread, 1 / root of their eigenvalue, is not identifiable."""
    return int(np.sum(1.0 / np.sqrt(information_eigenvalues(G)) > WEAK_BELOW))


def prospects(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    candidates: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None,
    noise: float | None,
    newton: NewtonSettings | None,
) -> Prospects:
    """Solve what is there and the candidates in one batch; see `rank_configurations`.

    Raises:
        ValueError: If there is no candidate or a name repeats.
        RuntimeError: If a configuration that is there has no equilibrium.
    """
    known, tried = as_sequence(configurations), as_sequence(candidates)
    if not tried:
        raise ValueError("at least one candidate is needed, got none.")
    found = survey(
        model,
        parameters,
        (*known, *tried),
        at=at,
        noise=noise,
        newton=newton,
        required=len(known),
    )
    prior = prior_std(found.space)
    rows = [s.W * prior for s in found.sensed[: len(known)]]
    new = found.sensed[len(known) :]
    return Prospects(
        found.space,
        np.asarray(found.z),
        np.concatenate([np.zeros((0, len(prior))), *rows]),
        {s.name: s.W * prior for s in new if not _trouble(s)},
        tuple(Unranked(s.name, _trouble(s)) for s in new if _trouble(s)),
    )


def _trouble(s: Sensed) -> str:
    """Why a candidate cannot be judged; empty if it can."""
    return s.failure or ("" if len(s.W) else "it has no markers to measure")
