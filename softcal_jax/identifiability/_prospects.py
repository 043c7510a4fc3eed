"""Signal to noise of what is known and of candidate configurations."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import ParameterSpace, Uncertain
from softcal_jax.identifiability._gains import Gain, Unranked
from softcal_jax.identifiability._spread import (
    WEAK_BELOW,
    marginalised,
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
    """Signal to noise of what is known and of what candidates would add.

    Attributes:
        space: The parameters.
        z: Their scaled values, at which everything was linearised [-].
        known: Rows of the measured configurations, stacked: their signal per prior
            standard deviation, then their change by errors that are considered [-].
        candidates: The same of each candidate that has an equilibrium, by name.
        unranked: The other candidates.
    """

    space: ParameterSpace
    z: Float[HostArray, " n_p"]
    known: Float[HostArray, "n_e n_all"]
    candidates: dict[str, Float[HostArray, "_ n_all"]]
    unranked: tuple[Unranked, ...]

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.space.names)

    @property
    def told(self) -> Float[HostArray, "n n_p"]:
        """What the measured configurations tell, see `marginalised` [-]."""
        return self._told(self.known)

    def _told(self, rows: Float[HostArray, "n_e n_all"]) -> Float[HostArray, "n n_p"]:
        return marginalised(rows[:, : self.n_parameters], rows[:, self.n_parameters :])

    def with_measured(self, name: str) -> "Prospects":
        """Add a candidate to what is known, and remove it from the candidates."""
        known = np.concatenate([self.known, self.candidates[name]])
        rest = {k: G for k, G in self.candidates.items() if k != name}
        return replace(self, known=known, candidates=rest)

    def gain(self, name: str) -> Gain:
        """Compute what a candidate adds to what is known."""
        before = self.told
        after = self._told(np.concatenate([self.known, self.candidates[name]]))
        spreads = [np.sqrt(np.diag(posterior(G))) for G in (before, after)]
        best = int(np.argmax(spreads[0] - spreads[1]))
        parameter = self.space.parameters[best]
        prior = (si_slope(self.space, self.z) * prior_std(self.space))[best]
        value = np.asarray(self.space.from_scaled(jnp.asarray(self.z)))[best]
        old, new = (information_eigenvalues(G) for G in (before, after))
        return Gain(
            name=name,
            d_gain=float(np.sum(np.log(new)) - np.sum(np.log(old))),
            e_gain=float(new[-1] - old[-1]),
            blind_left=blind_count(after),
            parameter=parameter.name,
            before=float(prior * spreads[0][best]),
            after=float(prior * spreads[1][best]),
            value=float(value),
            unit=parameter.unit,
        )


def information_eigenvalues(
    G: Float[HostArray, "n_e n_p"],
) -> Float[HostArray, " n_p"]:
    """Compute the eigenvalues of M = I + G^T G, descending, from those of G [-]."""
    singular = np.linalg.svd(G, compute_uv=False)
    return 1.0 + np.pad(singular, (0, G.shape[1] - len(singular))) ** 2


def blind_count(G: Float[HostArray, "n_e n_p"]) -> int:
    """Count the directions that are not identifiable (spread = eigenvalue^-1/2)."""
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
    uncertain: Uncertain | None,
) -> Prospects:
    """Solve measured and candidate configurations in one batch.

    Raises:
        ValueError: If there is no candidate or a name repeats.
        RuntimeError: If an already measured configuration has no equilibrium.
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
        uncertain=uncertain,
        required=len(known),
    )
    prior = prior_std(found.space)
    rows = [_rows(s, prior) for s in found.sensed[: len(known)]]
    n_all = len(prior) + max((s.W_c.shape[1] for s in found.sensed), default=0)
    new = found.sensed[len(known) :]
    return Prospects(
        space=found.space,
        z=np.asarray(found.z),
        known=np.concatenate([np.zeros((0, n_all)), *rows]),
        candidates={s.name: _rows(s, prior) for s in new if not _trouble(s)},
        unranked=tuple(Unranked(s.name, _trouble(s)) for s in new if _trouble(s)),
    )


def _rows(s: Sensed, prior: Float[HostArray, " n_p"]) -> Float[HostArray, "n_e n_all"]:
    return np.concatenate([s.W * prior, s.W_c], axis=1)


def _trouble(s: Sensed) -> str:
    """Explain why a candidate cannot be ranked; empty if it can."""
    return s.failure or ("" if len(s.W) else "it has no markers to measure")
