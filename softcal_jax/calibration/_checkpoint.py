"""Time and progress of a calibration, saved so that it can be stopped and resumed."""

import hashlib
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.calibration._noise import CorrelatedNoise
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
    result as one that was never stopped.
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
        """Begin the journal with what the file holds, if there is one.

        `search` is what else the calibration depends on.

        Raises:
            ValueError: If the file is no checkpoint, or one of another calibration.
        """
        self.history: list[HistoryEntry] = []
        self.interrupted = False
        self.last: tuple[CalibrationState, CorrelatedNoise | None] | None = None
        self._problem, self._progress = problem, progress
        self._path = None if checkpoint is None else Path(checkpoint)
        self._begin = time.perf_counter()
        self._arrays: dict[str, HostArray] = {}
        if self._path is None:
            return
        self._mark = _fingerprint(problem, settings, search)
        if self._path.exists():
            self._load(self._path)
        if self.history:
            self._begin -= self.history[-1].seconds

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
        """Save a state or run: the file is replaced whole or not at all."""
        if self._path is None:
            return
        leaves = enumerate(jax.tree.leaves(tree))
        self._arrays |= {f"{name}_{i}": np.asarray(leaf) for i, leaf in leaves}
        texts = {"mark": self._mark, "history": json.dumps([*map(vars, self.history)])}
        partial = self._path.with_name(self._path.name + ".partial")
        with partial.open("wb") as file:
            np.savez(file, **texts, **self._arrays)  # type: ignore[arg-type]
        os.replace(partial, self._path)

    def kept(self, name: str, like: T) -> T | None:
        """Return what was saved, with the types of one like it; None if nothing was."""
        found = {n for n in self._arrays if n.rpartition("_")[0] == name}
        if not found:
            return None
        leaves, tree = jax.tree.flatten(like)
        shapes = {f"{name}_{i}": np.shape(leaf) for i, leaf in enumerate(leaves)}
        if {key: self._arrays[key].shape for key in found} != shapes:
            raise ValueError(
                f"{self._path} was written by another version of softcal_jax: remove "
                "it to start anew, or give another path."
            )
        kept = [self._arrays[key] for key in shapes]
        return jax.tree.unflatten(tree, map(_alike, leaves, kept))

    def _load(self, path: Path) -> None:
        try:
            # Opened here, since np.load does not close a file that it cannot read.
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                self._arrays = {name: file[name] for name in file.files}
            mark = str(self._arrays.pop("mark"))
            history = json.loads(str(self._arrays.pop("history")))
        except (
            OSError,
            EOFError,
            BadZipFile,
            ValueError,
            KeyError,
            TypeError,
        ) as error:
            raise ValueError(
                f"{path} is not a checkpoint of a calibration ({error}); give another "
                "path, or remove it."
            ) from error
        if mark != self._mark:
            raise ValueError(
                f"{path} is a checkpoint of another calibration: mesh, material, "
                "parameters, configurations, measurements and settings must be the "
                "same. Remove it to start anew, or give another path."
            )
        for entry in history:
            for name in ("lambda_p", "newton_steps"):
                entry[name] = tuple(entry[name])
            self.history.append(HistoryEntry(**entry))


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
        delta_e = problem.noise.without_attachments(delta_e, weight)
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


def _fingerprint(
    problem: CalibrationProblem, settings: CalibrationSettings, search: tuple
) -> str:
    """Digest everything that a calibration depends on."""
    # A sparse solver holds a handle that differs from one process to the next.
    problem = eqx.tree_at(lambda p: p.model.solver, problem, None)
    arrays, static = eqx.partition(problem, eqx.is_array_like)
    text = repr((settings, search, jax.tree.flatten(static)))
    digest = hashlib.sha256(text.encode())
    for leaf in map(np.asarray, jax.tree.leaves(arrays)):
        digest.update(f"{leaf.dtype}{leaf.shape}".encode() + leaf.tobytes())
    return digest.hexdigest()
