"""The file of a checkpoint: what it holds, and to which calibration it belongs."""

import hashlib
import json
import os
import zlib
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple
from zipfile import BadZipFile

import equinox as eqx
import jax
import numpy as np

from softcal_jax._names import listed
from softcal_jax._places import partial_of
from softcal_jax._typing import HostArray
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._result import HistoryEntry
from softcal_jax.calibration._state import CalibrationSettings

_UNREADABLE = (
    AttributeError,
    BadZipFile,
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
    TokenError,
    TypeError,
    ValueError,
    zlib.error,
)
"""What reading a file that is no checkpoint, or was edited by hand, may raise."""


class Saved(NamedTuple):
    """What a calibration saves: arrays by name, and its history."""

    arrays: dict[str, HostArray]
    history: tuple[HistoryEntry, ...]


def write_checkpoint(path: Path, mark: str, saved: Saved) -> None:
    """Replace a file whole, or leave it as it is.

    Args:
        path: The file.
        mark: `fingerprint` of the calibration.
        saved: What it holds.

    Raises:
        OSError: If it cannot be written.
    """
    texts = {
        "version": version("softcal-jax"),
        "mark": mark,
        "history": json.dumps([*map(vars, saved.history)]),
    }
    content = saved.arrays | {name: np.array(text) for name, text in texts.items()}
    digests = {name: _digest([array]) for name, array in content.items()}
    partial = partial_of(path)
    try:
        with partial.open("wb") as file:
            np.savez(file, digests=json.dumps(digests), **content)  # type: ignore[arg-type]
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def read_checkpoint(path: Path, mark: str) -> Saved:
    """Read the checkpoint of a calibration.

    Args:
        path: The file.
        mark: `fingerprint` of the calibration.

    Raises:
        ValueError: If it is no checkpoint, one of another calibration or version, or
            has been changed; the text says what to do.
    """
    try:
        # Opened here, since np.load does not close a file that it cannot read.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        digests = dict(json.loads(str(content.pop("digests"))))
        written_by, own_mark = str(content["version"]), str(content["mark"])
        history = tuple(map(_entry, json.loads(str(content["history"]))))
    except _UNREADABLE as error:
        raise ValueError(
            f"{path} is not a checkpoint of a calibration ({error}); give another "
            "path, or remove it."
        ) from error
    here = version("softcal-jax")
    if written_by != here:
        raise ValueError(
            f"{path} was written by softcal_jax {written_by}, and this is {here}: "
            "remove it to start anew, or give another path."
        )
    found = {name: _digest([array]) for name, array in content.items()}
    changed = sorted(dict(found.items() ^ digests.items()))
    if changed:
        raise ValueError(
            f"{path} is not as a calibration wrote it: {listed(changed)} differ. Take "
            "an earlier copy of it, remove it to start anew, or give another path."
        )
    if own_mark != mark:
        raise ValueError(
            f"{path} is a checkpoint of another calibration: mesh, material, "
            "parameters, configurations, measurements, noise, solver and settings must "
            "be the same. Remove it to start anew, or give another path."
        )
    texts = ("version", "mark", "history")
    return Saved({n: a for n, a in content.items() if n not in texts}, history)


def _entry(saved: Any) -> HistoryEntry:
    """Return an entry of the history with its lists as tuples again."""
    as_tuples = {name: tuple(saved[name]) for name in ("lambda_p", "newton_steps")}
    return HistoryEntry(**(saved | as_tuples))


def fingerprint(
    problem: CalibrationProblem, settings: CalibrationSettings, search: tuple
) -> str:
    """Digest everything that a calibration depends on; `search` is what else does.

    A sparse solver counts by its name and pattern, since it holds a handle that differs
    from one process to the next.
    """
    solver = problem.model.solver
    kind = solver.name, solver.sparsity
    problem = eqx.tree_at(lambda p: p.model.solver, problem, kind)
    arrays, static = eqx.partition(problem, eqx.is_array_like)
    text = eqx.tree_pformat((settings, search, static))  # not repr, which shortens
    return _digest(map(np.asarray, jax.tree.leaves(arrays)), text)


def _digest(arrays: Iterable[HostArray], text: str = "") -> str:
    digest = hashlib.sha256(text.encode())
    for array in arrays:
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
