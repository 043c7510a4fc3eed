"""Time and progress of a calibration, saved so that it can be stopped and resumed."""

import os
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import one_line
from softcal_jax._places import cause, only_writer
from softcal_jax._typing import HostArray
from softcal_jax.calibration._checkpoint_file import (
    Saved,
    fingerprint,
    read_checkpoint,
    write_checkpoint,
)
from softcal_jax.calibration._noise import CorrelatedNoise
from softcal_jax.calibration._notes import CalibrationWarning
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._result import HistoryEntry
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState

T = TypeVar("T")


class Clock:
    """Context that splits its wall time into compiling by JAX and everything else.

    JAX reports the duration of each trace, lowering and compilation when it ends;
    nested ones are counted once.

    Attributes:
        seconds: "compile" and "solve", after the context has ended [s].
    """

    __repr__ = one_line

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self._compiling: list[tuple[float, float]] = []

    def __enter__(self) -> "Clock":
        self._begin = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(self, *_) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listen)
        compiling, reached = 0.0, self._begin
        for begin, end in sorted(self._compiling):
            compiling += max(0.0, end - max(begin, reached))
            reached = max(reached, end)
        elapsed = time.perf_counter() - self._begin
        self.seconds = {"compile": compiling, "solve": elapsed - compiling}

    def _listen(self, event: str, duration_secs: float, **_) -> None:
        if event.startswith("/jax/core/compile/"):
            now = time.perf_counter()
            self._compiling.append((now - duration_secs, now))


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
        unsaved: Why the file is older than the history; empty if it is not.
    """

    def __init__(
        self,
        problem: CalibrationProblem,
        settings: CalibrationSettings,
        checkpoint: str | os.PathLike[str] | None,
        progress: Callable[[HistoryEntry], None] | None = None,
        *,
        search: tuple,
    ):
        """Take what is reported where; `search` is what else the fit depends on."""
        self.history: list[HistoryEntry] = []
        self.interrupted = False
        self.last: tuple[CalibrationState, CorrelatedNoise | None] | None = None
        self.unsaved = ""
        self._problem, self._progress = problem, progress
        self._depends_on = problem, settings, search
        self._path = None if checkpoint is None else Path(checkpoint)
        self._begin = time.perf_counter()
        self._arrays: dict[str, HostArray] = {}
        self._open = ExitStack()

    def __enter__(self) -> "Journal":
        """Begin with what the file holds, if there is one.

        Raises:
            ValueError: If the file is no checkpoint, or one of another calibration.
            OSError: If the file cannot be written, or another calibration writes to it.
        """
        if self._path is None:
            return self
        with ExitStack() as opened:
            opened.enter_context(only_writer(self._path, "calibration"))
            self._mark = fingerprint(*self._depends_on)
            if self._path.exists():
                saved = read_checkpoint(self._path, self._mark)
                self._arrays, self.history = saved.arrays, [*saved.history]
            self._open = opened.pop_all()
        if self.history:
            self._begin -= self.history[-1].seconds
        return self

    def __exit__(self, *_) -> None:
        self._open.close()

    @property
    def stands(self) -> str:
        """Say that the calibration can go on from the file; empty if it cannot."""
        if self._path is None or not self._path.exists():
            return ""
        return f" The checkpoint {self._path} stands: the same call goes on from it."

    @property
    def notes(self) -> tuple[str, ...]:
        """Say that the file is behind, if it is."""
        return (self.unsaved,) if self.unsaved else ()

    def note(self, state: CalibrationState, noise: CorrelatedNoise | None) -> None:
        """Record a step, and the noise in whose units it was taken."""
        self.last = state, noise
        seconds = time.perf_counter() - self._begin
        entry = _history_entry(state, self._problem.with_noise(noise), seconds)
        self.history.append(replace(entry, step=len(self.history)))
        self.keep("state", (state, noise))
        if self._progress:
            self._progress(self.history[-1])

    def begin(
        self, state: CalibrationState, noise: CorrelatedNoise | None
    ) -> tuple[CalibrationState, CorrelatedNoise | None]:
        """Return the saved state and noise; record and return these without them."""
        kept = self.kept("state", (state, noise))
        if kept is None:
            self.note(state, noise)
        self.last = kept or (state, noise)
        return self.last

    def keep(self, name: str, tree: Any) -> None:
        """Save a state or run: the file is replaced whole or not at all.

        Where it cannot be written any more, as on a full disk, the calibration goes on
        without: hours of work would be lost with it. After an interruption it stays as
        it is, since what follows is no part of a whole calibration.
        """
        if self._path is None or self.interrupted:
            return
        leaves = enumerate(jax.tree.leaves(tree))
        self._arrays |= {f"{name}_{i}": np.asarray(leaf) for i, leaf in leaves}
        saved = Saved(self._arrays, tuple(self.history))
        try:
            write_checkpoint(self._path, self._mark, saved)
            self.unsaved = ""
        except OSError as error:
            self._tell_unsaved(cause(error))

    def _tell_unsaved(self, why: str) -> None:
        """Note that the file is behind, and warn once."""
        text = (
            f"The checkpoint {self._path} could not be written ({why}), and holds an "
            "earlier state or none."
        )
        if text != self.unsaved:
            more = f"{text} The calibration goes on: make room for it."
            warnings.warn(more, CalibrationWarning, stacklevel=3)
        self.unsaved = text

    def kept(self, name: str, like: T) -> T | None:
        """Return what was saved, with the types of one like it; None if nothing was."""
        found = {n for n in self._arrays if n.rpartition("_")[0] == name}
        if not found:
            return None
        leaves, tree = jax.tree.flatten(like)
        kinds = {f"{name}_{i}": _kind(leaf) for i, leaf in enumerate(leaves)}
        if {key: _kind(self._arrays[key]) for key in found} != kinds:
            raise ValueError(
                f"{self._path} was written by another version of softcal_jax: remove "
                "it to start anew, or give another path."
            )
        kept = [self._arrays[key] for key in kinds]
        return jax.tree.unflatten(tree, map(_alike, leaves, kept))


def _kind(leaf) -> tuple:
    """Return what a saved array must have in common with the leaf it replaces."""
    array = np.asarray(leaf)
    return array.shape, array.dtype


def _alike(leaf, array: HostArray):
    """Convert a saved array to the type of the leaf that it replaces."""
    if isinstance(leaf, np.ndarray):
        return array
    return jnp.asarray(array) if isinstance(leaf, jax.Array) else type(leaf)(array)


def _history_entry(
    state: CalibrationState, problem: CalibrationProblem, seconds: float
) -> HistoryEntry:
    """Summarise a step for the history."""
    evaluation = state.evaluation
    effectors = problem.configurations.effectors
    n_points = effectors.nodes.shape[-2]  # rms of distances: leave out angles, forces
    # On the host: on the device, each shape of the data would be more programs.
    weight, delta_e = np.asarray(effectors.inverse_std), np.asarray(evaluation.delta_e)
    if problem.noise is not None:
        delta_e = problem.noise.without_attachments(effectors, delta_e)
    seen = weight[:, :n_points] > 0.0
    squares = np.sum(np.where(seen, delta_e[:, :n_points], 0.0) ** 2)
    markers = max(int(np.sum(np.any(seen, axis=-1))), 1)
    p = problem.space.from_scaled(state.z)
    return HistoryEntry(
        step=int(state.step),
        cost=float(evaluation.cost),
        rms=float(np.sqrt(squares / markers)),
        lambda_p=tuple(float(v) for v in state.lambda_p),
        step_bound=float(state.step_bound),
        accepted=bool(state.accepted),
        kkt_residual=float(state.kkt_residual),
        newton_steps=tuple(int(n) for n in evaluation.equilibrium.steps),
        values={n: float(v) for n, v in zip(problem.space.names, p, strict=True)},
        noise_level=1.0 if problem.noise is None else float(problem.noise.jitter),
        seconds=seconds,
    )
