"""Calibrations of the small project beside another user of the process, by name.

Run as a script with the name of a function here and a folder: it prints the calibrated
moduli [Pa] as JSON, and anything else that went wrong ends it with a traceback.
"""

import asyncio
import json
import multiprocessing
import os
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg


def calibrated(folder):
    """Modulus of a calibration [Pa]; imports first what a program needs for it."""
    import jax
    from small_project import write_small_project

    from softcal_jax.project import load_project

    jax.config.update("jax_enable_x64", True)
    return load_project(write_small_project(Path(folder))).calibrate().value("E")


FINE = (
    ("cells = [3, 1, 1]", "cells = [12, 4, 4]"),
    ('element = "linear"', 'element = "quadratic"'),
)
"""Large enough for several threads in one factorization."""


def calibrated_with_all_cores(folder):
    """The same on a finer mesh, with one pose: threads share its factorizations."""
    import jax
    from small_project import write_small_project

    from softcal_jax.calibration import calibrate
    from softcal_jax.fields import exactly_known
    from softcal_jax.project import load_project

    jax.config.update("jax_enable_x64", True)
    project = load_project(write_small_project(Path(folder), *FINE))
    fitted = project.model, project.space, project.calibration
    result = calibrate(*fitted, uncertain=exactly_known(), intervals=None)
    return result.value("E")


def matrix():
    """A well-conditioned matrix, large enough for threads."""
    return np.random.default_rng(0).random((400, 400)) + 20.0 * np.eye(400)


def torch_computes():
    """Products, solutions and eigenvalues of torch, against NumPy and SciPy."""
    import torch

    A = matrix()
    a = torch.from_numpy(A)
    np.testing.assert_allclose((a @ a).numpy(), A @ A, rtol=1e-10)
    np.testing.assert_allclose(torch.linalg.solve(a, a @ a).numpy(), A, rtol=1e-8)
    expected = scipy.linalg.eigvalsh(A + A.T)
    np.testing.assert_allclose(torch.linalg.eigvalsh(a + a.T), expected, rtol=1e-8)


def torch_before(folder):
    """It has computed before the first calibration, and does between two."""
    torch_computes()
    first = calibrated(folder)
    torch_computes()
    return [first, calibrated(folder)]


def torch_after(folder):
    """It is imported when a calibration has ended, and another follows."""
    first = calibrated(folder)
    torch_computes()
    return [first, calibrated(folder)]


def torch_threads(folder):
    """It changes the number of threads for OpenMP and oneMKL of the whole process."""
    moduli = [calibrated_with_all_cores(folder)]
    import torch

    for n in (1, os.cpu_count()):
        torch.set_num_threads(n)
        torch_computes()
        moduli.append(calibrated_with_all_cores(folder))
    return moduli


@contextmanager
def busy(n_threads):
    """Threads of NumPy and SciPy that check their own results meanwhile."""
    A, done, wrong = matrix(), threading.Event(), []
    product = A @ A

    def work():
        while not done.is_set():
            solution = scipy.linalg.solve(A, A @ A)
            if not np.allclose(A @ A, product) or not np.allclose(solution, A):
                wrong.append(threading.get_ident())

    threads = [threading.Thread(target=work) for _ in range(n_threads)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        done.set()
        for thread in threads:
            thread.join()
    assert not wrong


def numpy_threads(folder):
    """NumPy and SciPy compute in two threads while a calibration runs."""
    with busy(2):
        return [calibrated(folder)]


def two_threads(folder):
    """Two threads with calibrations of the same mesh: first small ones, then fine."""
    folders = [f"{folder}/{k}" for k in range(4)]
    with ThreadPoolExecutor(2) as pool:
        moduli = list(pool.map(calibrated, folders))
        fine = list(pool.map(calibrated_with_all_cores, folders))
    assert len(set(fine)) == 1, fine
    return moduli


def event_loop(folder):
    """In a coroutine, and in a thread while the loop goes on."""

    async def main():
        blocking = calibrated(folder)
        beside = asyncio.create_task(asyncio.to_thread(calibrated, folder))
        turns = 0
        while not beside.done():
            turns += 1
            await asyncio.sleep(0.01)
        assert turns > 10, "the loop stood still"
        return [blocking, await beside]

    return asyncio.run(main())


def joblib_processes(folder, backend="loky"):
    """Two jobs of joblib, of a process that has calibrated as well."""
    from joblib import Parallel, delayed

    here = calibrated(folder)
    folders = [f"{folder}/{k}" for k in range(2)]
    jobs = Parallel(2, backend=backend)(delayed(calibrated)(f) for f in folders)
    return [here, *jobs]


def joblib_threads(folder):
    """The same with threads."""
    return joblib_processes(folder, "threading")


def _in_fork(folder, queue):
    try:
        queue.put(calibrated(folder))
    except RuntimeError as error:
        queue.put(str(error))


def _forked(folder):
    """What a forked child finds, or says."""
    fork = multiprocessing.get_context("fork")
    queue = fork.Queue()
    child = fork.Process(target=_in_fork, args=(folder, queue), daemon=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX warns as well
        child.start()
    return queue.get(timeout=100)


def fork_before(folder):
    """A child forked after the imports, and a calibration in its parent."""
    import jax  # noqa: F401

    import softcal_jax.project  # noqa: F401

    return [_forked(folder), calibrated(folder)]


def fork_after(folder):
    """A child of a process that has calibrated is told what to do instead."""
    first = calibrated(folder)
    said = _forked(folder)
    assert "was forked" in said, said
    assert 'get_context("spawn")' in said
    return [first, calibrated(folder)]


def float32_later(folder):
    """Another part of the program switches float64 off between two calibrations."""
    import jax
    from small_project import write_small_project

    from softcal_jax.project import load_project

    first = calibrated(folder)
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(ValueError, match=r"float64.*float32"):
        load_project(write_small_project(Path(folder))).calibrate()
    return [first, calibrated(folder)]


def alone(folder):
    """Nothing else in the process: what matters is its environment."""
    return [calibrated(folder)]


if __name__ == "__main__":
    scenario, where = sys.argv[1:]
    json.dump(globals()[scenario](where), sys.stdout)
