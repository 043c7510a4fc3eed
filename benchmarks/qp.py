"""The QP of a calibration step: which of its stages solves it.

First in the steps of calibrations of the paper's beam from random starts; there it
counts how many BoxOSQP solved alone. Then on random problems:
10 000 problems of 1 to 36 parameters and twice as many rows: conditions of W from 1 to
1e8, W of lower rank in a third, bounds of any size beside that of the step, and four
kinds of rows. A stage has solved a problem where the KKT residual is at most that of
`propose`. The kind "away" excludes no step, which no calibration does.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._paper import measured_beam
from benchmarks._problem import Better, Figure, Options, Outcome, Table
from softcal_jax.calibration import FROM_ANYWHERE, Evaluator, _qp
from softcal_jax.calibration._runs import minimise
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import random_starts

PROBLEMS = {1: 2000, 3: 2500, 6: 2500, 12: 2500, 36: 500}
"""Number of problems by number of parameters."""

KINDS = ("none", "order", "degenerate", "dense", "away")
STAGES = ("polish", "boxosqp", "all")
"""The active-set method and BoxOSQP, each alone from no step; then both in turn."""

STARTS = 30
"""Random starts from which the beam is calibrated."""


def run(options: Options) -> Outcome:
    """Solve all problems with every stage."""
    residuals: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
    options.say("steps of calibrations")
    figures: dict[str, Figure] = steps_of_calibrations()
    for n, count in PROBLEMS.items():
        options.say(f"{n} parameters")
        random = np.random.default_rng(n)
        drawn = [
            random_qp(random, n, kind)
            for kind in KINDS
            for _ in range(count // len(KINDS))
        ]
        problems = jax.tree.map(lambda *a: jnp.asarray(np.stack(a)), *drawn)
        kkt = np.split(np.asarray(_stages(problems)), len(KINDS))
        for kind, rows in zip(KINDS, kkt, strict=True):
            residuals[kind].append(rows)
        jax.block_until_ready(_steps(problems))  # compiles
        begin = time.perf_counter()
        jax.block_until_ready(_steps(problems))
        figures[f"n{n}_us"] = 1e6 * (time.perf_counter() - begin) / len(drawn)
    by_kind = {kind: np.concatenate(rows) for kind, rows in residuals.items()}
    by_kind["any"] = np.concatenate(list(by_kind.values()))
    table = []
    for kind, kkt in by_kind.items():
        share = np.mean(kkt <= _qp.KKT_TOLERANCE, axis=0).tolist()
        table.append([kind, *(f"{100 * value:.2f} %" for value in share)])
        for stage, value in zip(STAGES, share, strict=True):
            figures[f"{kind}_solved_by_{stage}"] = value
    better: dict[str, Better] = {
        name: "higher" if name.endswith("by_all") else "either"
        for name in figures
        if "solved" in name
    }
    tables = [Table("QPs solved", ["rows", *STAGES], table)]
    return Outcome(figures, {}, {}, tables, better)


def steps_of_calibrations() -> dict[str, Figure]:
    """Count the steps of calibrations, and those that BoxOSQP solved alone."""
    problem = measured_beam().problem
    by_polish: list[bool] = []
    note = lambda state: by_polish.append(bool(state.by_polish))
    lanes = len(problem.configurations.gravity)
    with Workers(problem.model, lanes) as workers:
        evaluate = Evaluator(problem, workers)
        for start in random_starts(problem.space, STARTS, seed=0):
            minimise(evaluate, FROM_ANYWHERE, start, note=note)
    alone = 1.0 - float(np.mean(by_polish))
    return {"steps": len(by_polish), "steps_solved_by_boxosqp": alone}


def random_qp(random: np.random.Generator, n: int, kind: str) -> tuple[np.ndarray, ...]:
    """Draw W, error, bounds, rows and right-hand sides of a problem."""
    m, rank = 3 * n + 4, max(1, n // 2) if random.random() < 1 / 3 else n
    U, V = (np.linalg.qr(random.normal(size=(k, rank)))[0] for k in (m, n))
    W = U * np.logspace(0.0, -random.uniform(0.0, 8.0), rank) @ V.T
    error = W @ random.normal(size=n) + 10.0 ** random.uniform(-6, 0) * random.normal(
        size=m
    )
    low, high = -np.abs(random.normal(size=(2, n))) * 10.0 ** random.uniform(-3, 1)
    high, tight = -high, random.random(n)
    low, high = np.where(tight < 0.1, 0.0, low), np.where(tight > 0.9, 0.0, high)
    A, b = np.zeros((2 * n, n)), np.abs(random.normal(size=2 * n))
    b *= random.integers(0, 2, 2 * n) * high.max()
    if kind == "dense":  # as the bounds of moduli are rows where the steps are tensors
        A = np.concatenate([np.eye(n), -np.eye(n)]) @ random.normal(size=(n, n))
    elif kind != "none" and n > 1:  # as E_l <= E_t
        for row in A:
            pair = np.exp(random.normal(size=2)) * [1.0, -1.0]
            row[random.choice(n, 2, replace=False)] = pair
    if kind == "degenerate":  # rows that meet in no step, and come twice
        A[n:], b[:] = 2.0 * A[:n], 0.0
    elif kind == "away":
        b += A @ random.uniform(low, high)
    elif kind == "none":
        b[:] = 1.0
    return W, error, low, high, A, b


@jax.jit
def _stages(problems) -> jax.Array:
    """Compute the KKT residual after each of `STAGES`."""

    def one(problem):
        *box, A, b = problem
        W, error, low, high = box
        qp = _qp.scaled_qp(W, error, _qp.QPLimits(low, high, A, b, _qp.DAMPING))
        start = _qp._no_step(qp)
        polished, iterated = _qp._descended(qp, start), _qp._iterated(qp, start)
        return jnp.stack([polished.kkt, iterated.kkt, _qp.solved_qp(qp).kkt_residual])

    return jax.lax.map(one, problems)


@jax.jit
def _steps(problems):
    """Solve all problems one after the other."""

    def one(problem):
        *box, A, b = problem
        return _qp.bounded_step(*box, A=A, b=b)

    return jax.lax.map(one, problems)
