"""A calibration on disk after each step, so that it can be stopped and resumed."""

import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._result import HistoryEntry
from softcal_jax.calibration._state import CalibrationSettings, CalibrationState


class Journal:
    """History of a calibration: told to the user, and kept on disk if asked for."""

    def __init__(
        self,
        problem: CalibrationProblem,
        settings: CalibrationSettings,
        checkpoint: str | os.PathLike[str] | None,
        progress: Callable[[HistoryEntry], None] | None,
        *,
        search: tuple[float, ...] = (1, 0),
    ):
        self.history: list[HistoryEntry] = []
        self._problem, self._progress = problem, progress
        self._path = None if checkpoint is None else Path(checkpoint)
        self._mark = fingerprint(problem, settings, search) if self._path else ""
        self._begin = time.perf_counter()

    def load(self) -> "Checkpoint | None":
        """The checkpoint, if there is one; its history comes first then."""
        if self._path is None:
            return None
        saved = load_checkpoint(self._path, self._mark)
        if saved is not None:
            self.history += saved.history
        return saved

    def note(self, state: CalibrationState) -> None:
        """Record a step."""
        seconds = time.perf_counter() - self._begin
        self.history.append(history_entry(state, self._problem, seconds))
        if self._path is not None:
            save_checkpoint(self._path, self._mark, state, self.history)
        if self._progress:
            self._progress(self.history[-1])


def history_entry(
    state: CalibrationState, problem: CalibrationProblem, seconds: float
) -> HistoryEntry:
    """What a step is remembered by."""
    evaluation = state.evaluation
    effectors = problem.configurations.effectors
    n_points = effectors.nodes.shape[-2]  # a mean of lengths, not of angles
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


class Checkpoint(NamedTuple):
    """What is needed to go on, exactly as if nothing had stopped the calibration."""

    path: Path
    leaves: list[HostArray]
    history: list[HistoryEntry]


def fingerprint(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    search: tuple[float, ...],
) -> str:
    """Digest of everything that a calibration depends on."""
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
    path: Path, mark: str, state: CalibrationState, history: list[HistoryEntry]
) -> None:
    """Write a checkpoint; the file is replaced whole or not at all."""
    leaves = jax.tree.leaves(state)
    entries = json.dumps([vars(entry) for entry in history])
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        content = {f"state_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
        np.savez(file, mark=mark, history=entries, **content)  # type: ignore[arg-type]
    os.replace(partial, path)


def load_checkpoint(path: Path, mark: str) -> Checkpoint | None:
    """Read a checkpoint; None if there is no file.

    Raises:
        ValueError: If the file is no checkpoint, or one of another calibration.
    """
    if not path.exists():
        return None
    try:
        # Opened here: np.load leaves a file open that it cannot read.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        written = str(content.pop("mark"))
        history = json.loads(str(content.pop("history")))
        leaves = [content[f"state_{i}"] for i in range(len(content))]
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
    return Checkpoint(path, leaves, [HistoryEntry(**entry) for entry in history])


def resumed_state(like: CalibrationState, saved: Checkpoint) -> CalibrationState:
    """The state of a checkpoint.

    Args:
        like: A state of the same calibration.
        saved: The checkpoint.

    Raises:
        ValueError: If it was written by a version whose states hold something else.
    """
    shapes = [np.shape(leaf) for leaf in jax.tree.leaves(like)]
    if shapes != [leaf.shape for leaf in saved.leaves]:
        raise ValueError(
            f"{saved.path} was written by another version of softcal_jax: remove it to "
            "start anew, or give another path."
        )
    leaves = [jnp.asarray(leaf) for leaf in saved.leaves]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)
