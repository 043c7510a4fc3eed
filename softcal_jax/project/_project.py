"""Projects: files that were read and checked, ready to run, and their comparison."""

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import jax.numpy as jnp

from softcal_jax import calibration as calibrations, identifiability
from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable
from softcal_jax.calibration import CalibrationResult, ProjectSource
from softcal_jax.configurations import (
    Configuration,
    beyond,
    configuration_lanes,
)
from softcal_jax.designs import DesignResult, DesignWatch, design
from softcal_jax.equilibrium import (
    EquilibriumProgress,
    EquilibriumSolution,
    Model,
    NewtonSettings,
    Workers,
    equilibria,
    reports_of,
)
from softcal_jax.fields import Parameter, ParameterSpace, Uncertain
from softcal_jax.identifiability import Identifiability, Ranking
from softcal_jax.layouts import ModelComparison, compare_models
from softcal_jax.project._design import DesignTask
from softcal_jax.project._table import ProjectError, in_file, one_by_one, under
from softcal_jax.readings import Registration, Traces
from softcal_jax.unknowns import Problem, check_references

_NO_PARAMETERS = "parameters: nothing to calibrate; add [[parameters]]."


class Project(Module):
    """A project file as objects; everything in it has been checked.

    Attributes:
        name: Name of the project.
        path: The project file.
        source: The project file and the files that it names, as they were when read.
        model: The model, with the start values of the parameters.
        space: The parameters; None for a file without parameters.
        calibration: Configurations that are fitted.
        validation: Configurations that are only predicted.
        candidates: Configurations that might be measured, see `rank_candidates`.
        asked: Configurations with goals, and what may be designed for them.
        noise: Where the noise comes from: "estimated" or "stated".
        starts: Number of starts; None for `default_starts`.
        seed: Seed of the random starts.
        intervals: Level of the intervals of the parameters; None for none [-].
        precision: Standard error that is asked for, relative to the value [-].
        uncertain: How well everything is known that is not calibrated.
        settings: Settings of the calibration.
        newton: Settings of the equilibrium.
        registrations: Registrations of the camera frames by configuration.
        traces: Recordings of markers and what was used of them, by configuration.
    """

    name: str
    path: Path
    source: ProjectSource
    model: Model
    space: ParameterSpace | None
    calibration: tuple[Configuration, ...]
    validation: tuple[Configuration, ...]
    candidates: tuple[Configuration, ...]
    asked: DesignTask
    noise: Literal["estimated", "stated"]
    starts: int | None
    seed: int
    intervals: float | None
    precision: float
    uncertain: Uncertain
    settings: calibrations.CalibrationSettings
    newton: NewtonSettings
    registrations: dict[str, Registration]
    traces: dict[str, Traces]

    def _words(self) -> str:
        counts = (
            f"{len(self.parameters)} parameters",
            f"{len(self.calibration)} configurations to fit",
            f"{len(self.validation)} held out",
        )
        return f"{', '.join(counts)}, {self.model.mesh.words}"

    @property
    def files(self) -> tuple[Path, ...]:
        """The project file and those that it names (mesh, measurements); absolute."""
        return tuple(file.path for file in (self.source.project, *self.source.files))

    @property
    def configurations(self) -> tuple[Configuration, ...]:
        """All configurations: the fitted ones, those held out, those with goals."""
        return self.calibration + self.validation + self.asked.goals

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters; empty for a file without any."""
        return () if self.space is None else self.space.parameters

    def check_calibration(self) -> None:
        """Raise ProjectError without parameters, or without data to fit them to."""
        problems = [] if self.space else [_NO_PARAMETERS]
        if not self.calibration:
            problems.append('configurations: none has role = "calibration".')
        problems += [
            f"configurations.{c.name}: it has no `measured` positions or effectors."
            for c in self.configurations
            if not c.is_measured
            and c.name not in {d.after for d in self.configurations}
        ]
        if problems:
            raise one_by_one(self.path, problems)

    def calibrate(
        self,
        *,
        start: Float[Array, " n_p"] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        watch: calibrations.Watch | Literal[False] | None = None,
    ) -> CalibrationResult:
        """Find the parameters, then predict the validation configurations.

        `converged` of the result says whether lambda_p vanished, and its notes how well
        the camera frames were registered. `start` are scaled parameters to start from
        instead of those of the file [-]; `checkpoint` and `watch` are those of
        `softcal_jax.calibrate`.

        Raises:
            ProjectError: If there is nothing to calibrate.
            ValueError: If the checkpoint is of another calibration.
            OSError: If it cannot be written, or another process is writing to it.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_calibration()
        assert self.space is not None
        result = calibrations.calibrate(
            self.model,
            self.space,
            self.calibration,
            validation=self.validation,
            noise=self.noise,
            uncertain=self.uncertain,
            precision=self.precision,
            settings=self.settings,
            newton=self.newton,
            starts=self.starts,
            seed=self.seed,
            start=start,
            intervals=self.intervals,
            checkpoint=checkpoint,
            watch=watch,
        )
        notes, fits = result.notes, self.registrations.items()
        if fits:
            rms = ", ".join(
                f"{name} {readable(fit.rms, 'distance')}" for name, fit in fits
            )
            notes += (f"Camera frames registered to the mesh with an rms of: {rms}.",)
        return dataclasses.replace(result, source=self.source, notes=notes)

    def check_design(self) -> None:
        """Raise ProjectError if no configuration has a goal."""
        if not self.asked.goals:
            raise ProjectError(
                f"{self.path}: configurations: none has a goal; give one "
                'goal = { tip = "(100, -, 12) mm" }, in place of `measured`.'
            )

    def design(
        self,
        *,
        watch: DesignWatch | Literal[False] | None = None,
    ) -> DesignResult:
        """Find the fields and the actuation that meet the goals of the file.

        See `softcal_jax.design`, also for what is raised.

        Raises:
            ProjectError: If no configuration has a goal.
        """
        self.check_design()
        return design(
            self.model,
            self.space,
            self.asked.goals,
            limits=self.asked.limits,
            foam=self.asked.foam,
            largest=self.asked.largest,
            change=self.asked.change,
            printing=self.asked.printing,
            robust=self.asked.robust,
            starts=self.starts,
            seed=self.seed,
            newton=self.newton,
            watch=watch,
        )

    def check_identify(self) -> None:
        """Raise ProjectError if nothing can be judged; no measured value is needed."""
        problems = [] if self.space else [_NO_PARAMETERS]
        posed = (*self.calibration, *self.candidates)
        if not posed:
            problems.append("configurations: none to fit, and no candidates.")
        elif not any(c.markers or c.effectors for c in posed):
            problems.append("markers: none to measure; add [markers] or [effectors].")
        if problems:
            raise one_by_one(self.path, problems)

    def identify(
        self, *, progress: Callable[[EquilibriumProgress], None] = lambda _: None
    ) -> Identifiability:
        """Judge what the calibration configurations can identify, measured or not.

        The verdict is at the start values, with the stated noise of all effectors.

        Raises:
            ProjectError: If there are no parameters, configurations or markers.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_identify()
        assert self.space is not None
        return identifiability.identify(
            self.model,
            self.space,
            self.calibration,
            newton=self.newton,
            uncertain=self.uncertain,
            precision=self.precision,
            progress=progress,
        )

    @property
    def proposals(self) -> tuple[Configuration, ...]:
        """What might be measured beside the candidates of the file, see `proposals`.

        First the poses to be predicted that go beyond all that are fitted.
        """
        asked = (c for c in self.validation if beyond(self.calibration, c))
        taken = {c.name for c in (*self.calibration, *self.candidates)}
        proposed = identifiability.proposals(self.model, self.calibration)
        named = {c.name: c for c in (*asked, *proposed)}
        return tuple(c for name, c in named.items() if name not in taken)

    def rank_candidates(
        self,
        *,
        proposals: bool = False,
        progress: Callable[[EquilibriumProgress], None] = lambda _: None,
    ) -> Ranking:
        """Rank the candidates, best first, by what they add to the configurations.

        With `proposals` beside those of the file, if asked.

        Raises:
            ProjectError: If there are no parameters, candidates or markers.
            RuntimeError: If a configuration has no equilibrium; the text names it.
        """
        self.check_identify()
        assert self.space is not None
        candidates = (*self.candidates, *(self.proposals if proposals else ()))
        if not candidates:
            raise ProjectError(f"{self.path}: candidates: none; add [[candidates]].")
        return identifiability.rank_configurations(
            self.model,
            self.space,
            self.calibration,
            candidates,
            newton=self.newton,
            uncertain=self.uncertain,
            precision=self.precision,
            progress=progress,
        )

    def check_simulation(self) -> None:
        """Raise ProjectError if there are no configurations to solve."""
        if not self.configurations:
            raise ProjectError(f"{self.path}: configurations: add [[configurations]].")

    def simulate(
        self,
        values: Mapping[str, float] | None = None,
        *,
        progress: Callable[[EquilibriumProgress], None] = lambda _: None,
    ) -> tuple[calibrations.SimulationResult, EquilibriumSolution]:
        """Solve the equilibria of all `configurations`, and compare what was measured.

        Args:
            values: Values of all parameters by name, in SI units, such as those of
                `load_values`; by default their start.
            progress: Called with each step of an equilibrium, and before the first.

        Raises:
            ProjectError: If there are no configurations, a parameter has no value, or
                `displacement_from` names no configuration like it.
        """
        self.check_simulation()
        posed, model = self.configurations, self.model
        lanes = configuration_lanes(model.mesh, posed, model.mechanism)
        with in_file(self.path), under("configurations"):
            check_references(posed, lanes.effectors)
        if values is not None:
            if self.space is None:
                raise ProjectError(f"{self.path}: {_NO_PARAMETERS}")
            missing = [name for name in self.space.names if name not in values]
            if missing:
                raise ProjectError(
                    f"{self.path}: parameters: there is no value of {listed(missing)}, "
                    f"only of {listed([*values])}; leave it out to keep its start."
                )
            z = self.space.to_scaled(jnp.array([values[n] for n in self.space.names]))
            fitted = Problem(model, self.space, lanes, posed)
            model, arrays = fitted.at(z)
            lanes = lanes._replace(arrays=arrays)
        report = reports_of(progress, [c.name for c in posed])
        with Workers(model, len(posed)) as pool:
            solved = equilibria(pool, model, lanes.arrays, self.newton, report=report)
        return calibrations.simulation_result(model, posed, solved, lanes), solved


def compare_projects(
    projects: Sequence[Project],
    *,
    progress: Callable[[str], None] | Literal[False] | None = None,
) -> ModelComparison:
    """Find the project whose law, mesh or parameters best predict held-out data.

    Every configuration with role = "calibration" is held out once, see
    `softcal_jax.layouts.compare_laws`. Starts and seed are those of the first project.

    Args:
        projects: Projects of the same configurations and measurements, in any order.
        progress: See `compare_laws`.

    Raises:
        ProjectError: If there are fewer than two projects, or one has nothing to
            calibrate or other configurations.
        ValueError: If there are fewer than two configurations, or measurements differ.
    """
    if len(projects) < 2:
        raise ProjectError(f"a comparison needs two projects, got {len(projects)}.")
    first, names = projects[0], [c.name for c in projects[0].calibration]
    for project in projects:
        project.check_calibration()
        given = [c.name for c in project.calibration]
        if sorted(given) != sorted(names):
            raise ProjectError(
                f"{project.path}: its configurations are {', '.join(given)}, but those "
                f"of {first.path} are {', '.join(names)}; a comparison needs the same."
            )
    problems = {}
    for name, project in projects_by_name(projects).items():
        assert project.space is not None  # `check_calibration` has seen to it
        posed = {c.name: c for c in project.calibration}
        with in_file(project.path), under("configurations"):
            problems[name] = calibrations.build_problem(
                project.model,
                project.space,
                [posed[key] for key in names],
                project.newton,
                uncertain=project.uncertain,
            )
    return compare_models(
        problems,
        starts=first.starts,
        seed=first.seed,
        progress=progress,
    )


def projects_by_name(projects: Sequence[Project]) -> Mapping[str, Project]:
    """Name projects by their names; where these repeat, by their files."""
    for name_of in (lambda p: p.name, lambda p: p.path.stem, lambda p: str(p.path)):
        named = {name_of(project): project for project in projects}
        if len(named) == len(projects):
            return named
    files = ", ".join(str(project.path) for project in projects)
    raise ProjectError(f"a project file is given twice: {files}.")
