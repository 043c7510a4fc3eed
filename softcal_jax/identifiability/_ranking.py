"""Rank configurations that might be measured next."""

from collections.abc import Sequence

import equinox as eqx

from softcal_jax._typing import Float
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import Uncertain
from softcal_jax.identifiability._gains import Gain, Unranked, gain_table
from softcal_jax.identifiability._prospects import blind_count, prospects
from softcal_jax.identifiability._survey import AnyVector, Parameters


class Ranking(eqx.Module):
    """Candidates, the most informative first.

    Attributes:
        gains: One entry per candidate that can be ranked.
        unranked: The others, with the reason.
        n_parameters: Number of parameters.
        blind_before: Number of directions that no measured configuration identifies.
    """

    gains: tuple[Gain, ...]
    unranked: tuple[Unranked, ...]
    n_parameters: int
    blind_before: int

    def __str__(self) -> str:
        """Describe the best candidate, and tabulate all."""
        lines = ["No candidate can be ranked."]
        if self.gains:
            best = self.gains[0]
            lines = [f"Candidate {best.name!r} adds most: it {best.words}."]
            lines += gain_table(self.gains, self.n_parameters)
            lines.append(
                f"Without a candidate {self.blind_before} of {self.n_parameters} "
                "directions are blind. Volume: factor on that of the uncertainty, "
                "exp(-D gain / 2). E gain: information added where there is least, in "
                "units of what the bounds know."
            )
        return "\n".join(lines + [str(u) for u in self.unranked])


def rank_configurations(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    candidates: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
) -> Ranking:
    """Rank candidate configurations by what they would tell, before measuring.

    Let G be the compliances in units of the noise per prior standard deviation,
    M = I + G^T G the information of prior and configurations, and J = G_c^T G_c that of
    a candidate. Candidates are ordered by log det(M + J) - log det M (D-optimality;
    Chaloner and Verdinelli, Statistical Science 10, 1995). The increase of the smallest
    eigenvalue of M (E-optimality) is given too: D rewards shrinking any direction of
    the uncertainty, E only the worst one.

    Args:
        model: The model.
        parameters: Parameters that are, or would be, calibrated.
        configurations: Configurations measured already; may be empty.
        candidates: Configurations that might be measured, with any loads, orientation,
            supports and markers, and with names of their own.
        at: Scaled values z to linearise at, such as `CalibrationResult.z`; the start
            by default [-].
        noise: Standard deviation of every measured coordinate; by default that of the
            markers [m].
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated; the defaults of
            `Uncertain` by default.

    Returns:
        The candidates, the best first. Those without an equilibrium at these values or
        without markers are listed with the reason.

    Raises:
        ValueError: If an input is wrong, there is no candidate, or a name repeats.
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
    gains = [found.gain(name) for name in found.candidates]
    return Ranking(
        tuple(sorted(gains, key=lambda gain: -gain.d_gain)),
        found.unranked,
        found.n_parameters,
        blind_count(found.told),
    )
