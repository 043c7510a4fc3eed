"""The progress of a calibration, saved so that it can be stopped and resumed."""

import hashlib
import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._result import HistoryEntry
from softcal_jax.calibration._runs import Begun
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState


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
        search: tuple = (1, 0),
    ):
        """Begin an empty journal.

        Args:
            problem: The calibration.
            settings: Settings of the outer loop.
            checkpoint: The file, if any.
            progress: Called after each step.
            search: What else the calibration depends on.
        """
        self.history: list[HistoryEntry] = []
        self._problem, self._progress = problem, progress
        self._path = None if checkpoint is None else Path(checkpoint)
        self._mark = fingerprint(problem, settings, search) if self._path else ""
        self._begin = time.perf_counter()
        self._arrays: dict[str, HostArray] = {}

    def load(self) -> None:
        """Read the file, if there is one.

        Raises:
            ValueError: If it is no checkpoint, or one of another calibration.
        """
        if self._path is not None and self._path.exists():
            self._arrays, self.history = load_checkpoint(self._path, self._mark)

    def note(self, state: CalibrationState) -> None:
        """Record a step."""
        seconds = time.perf_counter() - self._begin
        self.history.append(history_entry(state, self._problem, seconds))
        self._keep("state", state)
        if self._progress:
            self._progress(self.history[-1])

    def begin(self, state: CalibrationState) -> CalibrationState:
        """Return the saved state; without one, record this state and return it.

        Args:
            state: State before the first step.
        """
        kept = self._kept("state", state)
        if kept is None:
            self.note(state)
        return kept or state

    def note_run(self, index: int, begun: Begun) -> None:
        """Record the progress of a run from one of many starts."""
        self._keep(f"run{index}", begun)

    def begun(self, index: int, like: Begun) -> Begun:
        """Return the progress of a run from one of many starts.

        Args:
            index: Index of the start.
            like: The run before its first step.
        """
        return self._kept(f"run{index}", like) or like

    def _keep(self, name: str, tree) -> None:
        if self._path is None:
            return
        leaves = enumerate(jax.tree.leaves(tree))
        self._arrays |= {f"{name}_{i}": np.asarray(leaf) for i, leaf in leaves}
        save_checkpoint(self._path, self._mark, self._arrays, self.history)

    def _kept(self, name: str, like):
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


def _alike(leaf, array: HostArray):
    """Convert a saved array to the type of the leaf that it replaces."""
    if isinstance(leaf, np.ndarray):
        return array
    return jnp.asarray(array) if isinstance(leaf, jax.Array) else type(leaf)(array)


def history_entry(
    state: CalibrationState, problem: CalibrationProblem, seconds: float
) -> HistoryEntry:
    """Summarise a step for the history."""
    evaluation = state.evaluation
    effectors = problem.configurations.effectors
    n_points = effectors.nodes.shape[-2]  # rms of distances: leave out angles, forces
    weight = effectors.inverse_std[:, :n_points]
    delta_e = evaluation.delta_e[:, :n_points]
    squares = jnp.sum(jnp.where(weight > 0, delta_e, 0.0) ** 2)
    markers = max(int(jnp.sum(jnp.any(weight > 0, axis=-1))), 1)
    p = problem.space.from_scaled(state.z)
    return HistoryEntry(
        step=int(state.step),
        cost=float(evaluation.cost),
        rms=float(jnp.sqrt(squares / markers)),
        lambda_p=tuple(float(v) for v in state.lambda_p),
        step_bound=float(state.step_bound),
        accepted=bool(state.accepted),
        kkt_residual=float(state.kkt_residual),
        newton_steps=tuple(int(n) for n in evaluation.equilibrium.steps),
        values={n: float(v) for n, v in zip(problem.space.names, p, strict=True)},
        seconds=seconds,
    )


def fingerprint(
    problem: CalibrationProblem, settings: CalibrationSettings, search: tuple
) -> str:
    """Digest everything that a calibration depends on."""
    digest = hashlib.sha256(repr((settings, problem.newton, search)).encode())
    for part in (
        problem.model.mesh,
        problem.model.law,
        problem.model.density,
        problem.space,
        problem.configurations,
    ):
        arrays, static = eqx.partition(part, eqx.is_array_like)
        digest.update(repr(jax.tree.structure(static)).encode())
        for leaf in jax.tree.leaves(arrays):
            digest.update(np.ascontiguousarray(leaf).tobytes())
    return digest.hexdigest()


def save_checkpoint(
    path: Path,
    mark: str,
    arrays: Mapping[str, HostArray],
    history: list[HistoryEntry],
) -> None:
    """Write a checkpoint atomically: the file is replaced whole or not at all."""
    entries = json.dumps([vars(entry) for entry in history])
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        np.savez(file, mark=mark, history=entries, **arrays)  # type: ignore[arg-type]
    os.replace(partial, path)


def load_checkpoint(
    path: Path, mark: str
) -> tuple[dict[str, HostArray], list[HistoryEntry]]:
    """Read a checkpoint: its arrays and its history.

    Raises:
        ValueError: If the file is no checkpoint, or one of another calibration.
    """
    try:
        # Opened here, since np.load does not close a file that it cannot read.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        written = str(content.pop("mark"))
        history = json.loads(str(content.pop("history")))
    except (OSError, EOFError, BadZipFile, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is not a checkpoint of a calibration ({error}); give another "
            "path, or remove it."
        ) from error
    if written != mark:
        raise ValueError(
            f"{path} is a checkpoint of another calibration: mesh, material, "
            "parameters, configurations, measurements and settings must be the same. "
            "Remove it to start anew, or give another path."
        )
    for entry in history:
        for name in ("lambda_p", "newton_steps"):
            entry[name] = tuple(entry[name])
    return content, [HistoryEntry(**entry) for entry in history]
