"""Time and progress of a calibration, saved so that it can be stopped and resumed."""

import json
import math
import os
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._files import digest_of
from softcal_jax._module import Module
from softcal_jax._places import cause, only_writer, replacing
from softcal_jax._text import listed
from softcal_jax._typing import HostArray
from softcal_jax._units import readable
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._notes import CalibrationWarning
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.equilibrium import effector_values
from softcal_jax.unknowns import CorrelatedNoise, Problem

T = TypeVar("T")

ANEW = "remove it to start anew, or give another path."
"""What to do about a file that is not the checkpoint of a calibration."""

# One row at a time, so that the program does not depend on the number of rows.
from_scaled = eqx.filter_jit(lambda space, z: space.from_scaled(z))


class HistoryEntry(Module):
    """One step of the outer loop.

    Attributes:
        step: Index of the step; 0 is the start.
        cost: Half the sum of squared errors in noise units [-].
        rms: Root mean square of the marker distances [m].
        lambda_p: The QP step [-].
        step_bound: Bound on the next step [-].
        accepted: Whether the step was accepted.
        kkt_residual: Optimality residual of the QP [-].
        newton_steps: Newton iterations of each configuration.
        values: Parameters after the step, in SI units.
        noise_level: Factor on the stated standard deviations that weighed the data; it
            changes where the noise has been estimated anew [-].
        seconds: Wall time spent so far, without pauses before a resume [s].
    """

    step: int
    cost: float
    rms: float
    lambda_p: tuple[float, ...] = eqx.field(converter=tuple)
    step_bound: float
    accepted: bool
    kkt_residual: float
    newton_steps: tuple[int, ...] = eqx.field(converter=tuple)
    values: dict[str, float]
    noise_level: float
    seconds: float

    def __str__(self) -> str:
        """Write the fit and the parameters after the step, in one line."""
        values = ", ".join(f"{name} {value:.5g}" for name, value in self.values.items())
        refused = "" if self.accepted else " (step refused)"
        misfit = f"rms {readable(self.rms, 'step of a fit')}"
        if math.isnan(self.rms):  # no points are measured
            misfit = f"cost {self.cost:.3g}"
        return f"step {self.step}: {misfit}, {values}{refused}"


def write_checkpoint(
    path: Path,
    mark: str,
    arrays: dict[str, HostArray],
    history: Sequence[HistoryEntry],
) -> None:
    """Replace a checkpoint as a whole, or leave it; `mark` is a `fingerprint`."""
    content = arrays | {
        "version": np.array(version("softcal-jax")),
        "mark": np.array(mark),
        "history": np.array(json.dumps([*map(vars, history)])),
    }
    digests = {name: digest_of([array]) for name, array in content.items()}
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez(file, digests=json.dumps(digests), **content)  # type: ignore[arg-type]


def read_checkpoint(
    path: Path, mark: str
) -> tuple[dict[str, HostArray], list[HistoryEntry]]:
    """Read the checkpoint of the calibration whose `fingerprint` is `mark`, as it was.

    Anything else is refused with what to do.
    """
    try:
        # Opened here, since np.load does not close a file that it cannot read.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        digests = dict(json.loads(str(content.pop("digests"))))
        changed = {
            n for n, a in content.items() if digests.pop(n, "") != digest_of([a])
        }
        texts = [str(content.pop(name)) for name in ("version", "mark", "history")]
        written_by, its_mark, history = texts
        entries = [HistoryEntry(**entry) for entry in json.loads(history)]
    except Exception as error:  # a dozen kinds, as the file may be anything
        raise ValueError(
            f"{path} is not a checkpoint of a calibration ({error}): {ANEW}"
        ) from error
    installed = version("softcal-jax")
    if written_by != installed:
        raise ValueError(
            f"{path} was written by softcal_jax {written_by}, and this is {installed}: "
            + ANEW
        )
    changed |= set(digests)
    if changed:
        raise ValueError(
            f"{path} is not as a calibration wrote it: {listed(sorted(changed))} "
            f"differ. Take an earlier copy of it, {ANEW}"
        )
    if its_mark != mark:
        raise ValueError(
            f"{path} is a checkpoint of another calibration: mesh, material, "
            "parameters, configurations, measurements, noise, solver and settings must "
            f"be the same. Otherwise {ANEW}"
        )
    return content, entries


def fingerprint(problem: Problem, settings: CalibrationSettings, search: tuple) -> str:
    """Digest everything that a calibration depends on; `search` holds the rest.

    A sparse solver counts by its name and pattern, since it holds a handle that differs
    from one process to the next; observations count by their values on a sheared robot.
    """
    effectors, read = problem.configurations.effectors, np.zeros(0)
    if effectors.observed:
        points = jnp.asarray(problem.model.mechanism.points)
        u = 0.01 * points + 0.02 * jnp.roll(points, 1, axis=1)
        compute = eqx.filter_jit(lambda c: effector_values(problem.model, c, u))
        read = np.stack([np.asarray(compute(lane)) for lane in problem.configurations])
    solver = problem.model.solver
    kind = solver.name, solver.sparsity
    problem = eqx.tree_at(lambda p: p.model.solver, problem.bare, kind)
    arrays, static = eqx.partition(problem, eqx.is_array_like)
    text = eqx.tree_pformat((settings, search, static))  # not repr, which shortens
    return digest_of([*jax.tree.leaves(arrays), read], text)


def marker_rms(problem: Problem, evaluation: Evaluation) -> float:
    """Compute the root mean square of the marker distances, nan without markers [m].

    Computed on the host: on the device, each shape of the data would compile programs.
    """
    effectors, noise = problem.configurations.effectors, problem.noise
    assert noise is not None
    n_points = effectors.nodes.shape[-2]  # later rows are no distances
    delta_e = noise.without_attachments(effectors, np.asarray(evaluation.delta_e))
    seen = np.asarray(effectors.inverse_std)[:, :n_points] > 0.0
    squares = np.sum(np.where(seen, delta_e[:, :n_points], 0.0) ** 2)
    markers = int(np.sum(np.any(seen, axis=-1)))
    return float(np.sqrt(squares / markers)) if markers else math.nan


class Journal:
    """History of a calibration: reported to the user, and saved if a file is given.

    The file holds the last state and, for a search from many starts, the best end of
    each run after each of its images, so that a resumed calibration gives the same
    result as one that was never stopped. Inside the context no other calibration
    writes to it.

    Attributes:
        history: Steps so far.
        interrupted: Whether the user has ended the calibration.
        last: State of the last step, and the noise in whose units it was taken.
        notes: Why the file is older than the history, if it is.
    """

    last: tuple[CalibrationState, CorrelatedNoise]

    def __init__(
        self,
        problem: Problem,
        settings: CalibrationSettings,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: Callable[[HistoryEntry], None] | None = None,
        *,
        search: tuple = (),
        history: Sequence[HistoryEntry] = (),
    ):
        """Note where steps are saved and reported; for `search` see `fingerprint`."""
        self.history = [*history]
        self.interrupted = False
        self.notes: tuple[str, ...] = ()
        self._problem, self._progress = problem, progress
        self._numbered = problem.space.numbered
        self._depends_on = problem, settings, search
        self._path = None if checkpoint is None else Path(checkpoint)
        self._begin = time.perf_counter()
        self._arrays: dict[str, HostArray] = {}
        self._open = ExitStack()

    def __enter__(self) -> "Journal":
        """Begin with what the file holds, if there is one."""
        if self._path is not None:
            with ExitStack() as opened:
                opened.enter_context(only_writer(self._path, "calibration"))
                self._mark = fingerprint(*self._depends_on)
                if self._path.exists():
                    saved = read_checkpoint(self._path, self._mark)
                    self._arrays, self.history = saved
                self._open = opened.pop_all()
        if self.history:
            self._begin -= self.history[-1].seconds
        return self

    def __exit__(self, *_) -> None:
        self._open.close()

    @property
    def interruption(self) -> str:
        """Say where the user has interrupted it, and how to go on from the file."""
        text = (
            f"Interrupted after step {self.history[-1].step}: the values are those of "
            "that step, and the noise is that which weighed it. Do not use them as a "
            "result."
        )
        if self._path is not None and self._path.exists():
            text += (
                f" The checkpoint {self._path} is kept: the same call resumes from it."
            )
        return text

    def note(self, state: CalibrationState, noise: CorrelatedNoise) -> None:
        """Record a step, and the noise in whose units it was taken."""
        self.last = state, noise
        evaluation, space = state.evaluation, self._problem.space
        p = np.asarray(from_scaled(self._numbered, state.z))
        entry = HistoryEntry(
            step=len(self.history),
            cost=float(evaluation.cost),
            rms=marker_rms(self._problem.with_noise(noise), evaluation),
            lambda_p=tuple(np.asarray(state.lambda_p).tolist()),
            step_bound=float(state.step_bound),
            accepted=bool(state.accepted),
            kkt_residual=float(state.kkt_residual),
            newton_steps=tuple(np.asarray(evaluation.equilibrium.steps).tolist()),
            values={n: float(v) for n, v in zip(space.names, p, strict=True)},
            noise_level=float(noise.jitter),
            seconds=time.perf_counter() - self._begin,
        )
        self.history.append(entry)
        self.keep("state", (state, noise))
        if self._progress:
            self._progress(entry)

    def begin(
        self, state: CalibrationState, noise: CorrelatedNoise
    ) -> tuple[CalibrationState, CorrelatedNoise]:
        """Return the saved state and noise; without any, record and return these."""
        kept = self.kept("state", (state, noise))
        if kept is None and not self.history:
            self.note(state, noise)
        self.last = kept or (state, noise)
        return self.last

    def keep(self, name: str, tree: Any) -> None:
        """Save a state or run: the file is replaced whole or not at all.

        Where the file cannot be written any more, as on a full disk, the calibration
        goes on without it, since stopping would lose hours of work. After an
        interruption it stays as it is: later states belong to no whole calibration.
        """
        if self._path is None or self.interrupted:
            return
        leaves = enumerate(jax.tree.leaves(tree))
        self._arrays |= {f"{name}_{i}": np.asarray(leaf) for i, leaf in leaves}
        try:
            write_checkpoint(self._path, self._mark, self._arrays, self.history)
            self.notes = ()
        except OSError as error:
            note = (
                f"The checkpoint {self._path} could not be written ({cause(error)}), "
                "and holds an earlier state or none."
            )
            if note not in self.notes:
                more = f"{note} The calibration continues without it: free disk space."
                warnings.warn(more, CalibrationWarning, stacklevel=2)
            self.notes = (note,)

    def kept(self, name: str, like: T) -> T | None:
        """Return what `keep` saved, typed like `like`; None if it saved nothing."""
        saved = {k: a for k, a in self._arrays.items() if k.rpartition("_")[0] == name}
        if not saved:
            return None
        leaves, tree = jax.tree.flatten(like)
        wanted = {f"{name}_{i}": leaf for i, leaf in enumerate(leaves)}
        kind = lambda leaf: (np.shape(leaf), np.asarray(leaf).dtype)
        if jax.tree.map(kind, saved) != jax.tree.map(kind, wanted):
            raise ValueError(
                f"{self._path} was written by another version of softcal_jax: {ANEW}"
            )
        values = [_alike(leaf, saved[key]) for key, leaf in wanted.items()]
        return jax.tree.unflatten(tree, values)


def _alike(leaf, array: HostArray):
    """Convert a saved array to the type of the leaf that it replaces."""
    if isinstance(leaf, np.ndarray):
        return array
    return jax.device_put(array) if isinstance(leaf, jax.Array) else type(leaf)(array)
