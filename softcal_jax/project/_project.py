"""A calibration as one file: read, checked as a whole, ready to run."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    HistoryEntry,
    SearchProgress,
    calibrate,
    profile_intervals,
)
from softcal_jax.configurations import (
    Configuration,
    Registration,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import (
    Identifiability,
    Ranking,
    identify,
    rank_configurations,
)
from softcal_jax.project._problems import ProjectError, one_by_one


class Project(eqx.Module):
    """A project file as objects; everything in it has been checked.

    Attributes:
        name: Name of the project.
        path: The file it came from.
        files: That file, and those that it names: the mesh, measurements.
        model: The body, with the start values of the parameters.
        space: What is calibrated; None for a file without parameters.
        calibration: Configurations that are fitted.
        validation: Configurations that are only predicted.
        candidates: Configurations that might be measured, see `rank_candidates`.
        noise: Where the noise comes from: "estimated" or "stated".
        starts: From how many starts the optimum is looked for.
        seed: Seed of the random ones.
        intervals: Level of the intervals by profile likelihood; None for none [-].
        settings: Settings of the calibration.
        newton: Settings of the equilibrium.
        registrations: How each camera frame was placed, by configuration; `rms` of
            each says how well.
    """

    name: str
    path: Path
    files: tuple[Path, ...]
    model: Model
    space: ParameterSpace | None
    calibration: tuple[Configuration, ...]
    validation: tuple[Configuration, ...]
    candidates: tuple[Configuration, ...]
    noise: Literal["estimated", "stated"]
    starts: int
    seed: int
    intervals: float | None
    settings: CalibrationSettings
    newton: NewtonSettings
    registrations: dict[str, Registration]

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All configurations, the fitted ones first."""
        return self.calibration + self.validation

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns one by one; empty for a file without parameters."""
        return () if self.space is None else self.space.parameters

    def check_calibration(self) -> None:
        """Checks that there is something to calibrate, and data to do it with.

        Raises:
            ProjectError: If parameters, fitted configurations or measurements are
                missing, which a simulation does not need.
        """
        problems = []
        if self.space is None:
            problems.append("parameters: nothing to calibrate; add [[parameters]].")
        if not self.calibration:
            problems.append(
                'configurations: none has role = "calibration", so there is nothing '
                "to fit."
            )
        problems += [
            f"configurations.{c.name}: it has no `measured` positions or effectors."
            for c in self.configurations
            if not c.is_measured
        ]
        if problems:
            raise one_by_one(self.path, problems)

    def calibrate(
        self,
        *,
        start: Float[Array, " n_p"] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: Callable[[HistoryEntry], None] | None = None,
        search_progress: Callable[[SearchProgress], None] | None = None,
    ) -> CalibrationResult:
        """Finds the parameters, then predicts the validation configurations.

        Args:
            start: Scaled parameters to start from, instead of those of the file [-].
            checkpoint: File that the state is kept in, and gone on from.
            progress: Called after the first evaluation and after each step.
            search_progress: Called when a run of a search from many starts has ended.

        Returns:
            The result; `result.converged` says whether lambda_p vanished. Its notes
            hold how well the camera frames were registered.

        Raises:
            ProjectError: If there is nothing to calibrate.
            ValueError: If the checkpoint is of another calibration.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_calibration()
        assert self.space is not None
        result = calibrate(
            self.model,
            self.space,
            self.calibration,
            validation=self.validation,
            noise=self.noise,
            settings=self.settings,
            newton=self.newton,
            starts=self.starts,
            seed=self.seed,
            start=start,
            checkpoint=checkpoint,
            progress=progress,
            search_progress=search_progress,
        )
        if not self.registrations:
            return result
        listed = ", ".join(
            f"{name} {1e3 * registration.rms:.2f} mm"
            for name, registration in self.registrations.items()
        )
        note = f"Camera frames registered to the mesh with an rms of: {listed}."
        return dataclasses.replace(result, notes=(*result.notes, note))

    def with_intervals(self, result: CalibrationResult) -> CalibrationResult:
        """The result with the intervals that the file asks for; a note says if not.

        Args:
            result: What `calibrate` returned.
        """
        if self.intervals is None or not result.converged:
            return result
        try:
            found = profile_intervals(result, self.calibration, level=self.intervals)
        except (RuntimeError, ValueError) as error:
            note = f"No intervals: {error}"
            return dataclasses.replace(result, notes=(*result.notes, note))
        return dataclasses.replace(result, intervals=found)

    def check_identify(self) -> None:
        """Checks that there is something to judge; nothing need be measured.

        Raises:
            ProjectError: If parameters, poses or effectors are missing.
        """
        problems = []
        if self.space is None:
            problems.append("parameters: nothing to calibrate; add [[parameters]].")
        posed = (*self.calibration, *self.candidates)
        if not posed:
            problems.append(
                'configurations: none has role = "calibration", and there are no '
                "candidates."
            )
        if posed and not any(c.markers or c.effectors for c in posed):
            problems.append(
                "markers: there are none to measure; add [markers] or [effectors]."
            )
        if problems:
            raise one_by_one(self.path, problems)

    def identify(self) -> Identifiability:
        """What the calibration configurations would tell, measured or not.

        Returns:
            The verdict at the start values, with the stated noise of markers and other
            effectors.

        Raises:
            ProjectError: If there are no parameters, poses or markers.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_identify()
        assert self.space is not None
        return identify(self.model, self.space, self.calibration, newton=self.newton)

    def rank_candidates(self) -> Ranking:
        """What each candidate would add to the calibration configurations.

        Returns:
            The candidates, the best first.

        Raises:
            ProjectError: If there are no parameters, candidates or markers.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_identify()
        assert self.space is not None
        if not self.candidates:
            raise ProjectError(
                f"{self.path}: candidates: there are none; add [[candidates]]."
            )
        return rank_configurations(
            self.model,
            self.space,
            self.calibration,
            self.candidates,
            newton=self.newton,
        )

    def simulate(self) -> EquilibriumSolution:
        """Equilibria of all configurations with the start values.

        Returns:
            One lane per configuration, in the order of `configurations`;
            `check_converged` raises where one has no equilibrium.

        Raises:
            ProjectError: If there is none.
        """
        if not self.configurations:
            raise ProjectError(
                f"{self.path}: configurations: there is none to simulate; add "
                "[[configurations]]."
            )
        lanes = configuration_arrays(
            self.model.mesh, self.configurations, self.model.mechanism
        )
        return _simulate(self.model, lanes, self.newton)


@eqx.filter_jit
def _simulate(model, lanes, newton):
    solve = lambda lane, u: solve_equilibrium(model, lane, guess=u, settings=newton)
    rest = jnp.zeros((model.n_points, 3))
    if model.mechanism.bodies.n_bodies == 0:
        return jax.vmap(solve, (0, None))(lanes, rest)

    # Each from the one before: the poses of a robot with rigid bodies lie near each
    # other, and far from its parts before they were mounted.
    def follow(u, lane):
        found = solve(lane, u)
        return jnp.where(found.converged, found.displacement, u), found

    return jax.lax.scan(follow, rest, lanes)[1]
