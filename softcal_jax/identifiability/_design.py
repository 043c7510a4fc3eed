"""Choose which configurations to measure, one after the other."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import Uncertain
from softcal_jax.identifiability._gains import Gain, Unranked, gain_table
from softcal_jax.identifiability._identify import identifiability
from softcal_jax.identifiability._prospects import blind_count, prospects
from softcal_jax.identifiability._result import Identifiability
from softcal_jax.identifiability._spread import prior_std
from softcal_jax.identifiability._survey import AnyVector, Parameters


class Design(eqx.Module):
    """A sequence of configurations to measure.

    Attributes:
        steps: What each adds to the measured configurations and the previous steps.
        unranked: Candidates that could not be ranked.
        outcome: What all of them together would tell.
        blind_before: Number of directions that are not identifiable without them.
    """

    steps: tuple[Gain, ...]
    unranked: tuple[Unranked, ...]
    outcome: Identifiability
    blind_before: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the chosen candidates, in order."""
        return tuple(step.name for step in self.steps)

    def __str__(self) -> str:
        """Format the sequence, what it adds, and the verdict at its end."""
        n_p = self.outcome.n_parameters
        lines = ["No candidate can be ranked."]
        if self.steps:
            lines = [f"Measure in this order: {', '.join(self.names)}."]
            lines += gain_table(self.steps, n_p)
        lines.append(
            f"Blind directions: {self.blind_before} of {n_p} before, "
            f"{len(self.outcome.blind)} after."
        )
        return "\n".join([*lines, *map(str, self.unranked), "", str(self.outcome)])


def greedy_design(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    candidates: Configuration | Sequence[Configuration],
    n: int,
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
) -> Design:
    """Choose n candidates one by one, each time the one that adds most.

    log det M is submodular, so the greedy choice gains at least 1 - 1/e = 63 % of what
    the best n would gain (Nemhauser, Wolsey, Fisher, Math. Programming 14, 1978).

    Args:
        model: The model.
        parameters: Parameters that are, or would be, calibrated.
        configurations: Configurations measured already; may be empty.
        candidates: Configurations that might be measured, see `rank_configurations`.
        n: How many to choose; fewer are chosen where fewer have an equilibrium.
        at: Scaled values z to linearise at; the start by default [-].
        noise: Standard deviation of every measured coordinate; by default that of the
            markers [m].
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated; the defaults of
            `Uncertain` by default.

    Returns:
        The sequence and the verdict at its end, whose condition numbers are those of
        the noise-weighted compliances only.

    Raises:
        ValueError: If an input is wrong, or n is not between 1 and the number of
            candidates.
        RuntimeError: If an already measured configuration has no equilibrium.
    """
    found = prospects(
        model,
        parameters,
        configurations,
        candidates,
        at=at,
        noise=noise,
        newton=newton,
        uncertain=uncertain,
    )
    most = len(found.candidates) + len(found.unranked)
    if not 1 <= n <= most:
        raise ValueError(f"n must lie between 1 and {most} candidates, got {n}.")
    blind_before, steps = blind_count(found.told), []
    for _ in range(min(n, len(found.candidates))):
        gains = [found.gain(name) for name in found.candidates]
        steps.append(max(gains, key=lambda gain: gain.d_gain))
        found = found.with_measured(steps[-1].name)
    n_p = found.n_parameters
    outcome = identifiability(
        found.known[:, :n_p] / prior_std(found.space),
        found.space,
        np.asarray(found.z),
        n_data=len(found.known),
        W_c=found.known[:, n_p:],
    )
    return Design(tuple(steps), found.unranked, outcome, blind_before)
