"""Batches of configurations: on all cores, and as one call.

The 525-node beam of Sec. V under loads of its own in each lane.

- Throughput of evaluations (equilibria, errors, W_ep, as a step of a calibration takes
  them) of 1 to 64 lanes side by side on all cores, over that of one core: processes of
  their own, one after the other, of which the second may use a single core. Each lane
  starts from the equilibria of parameters that are a step away.
- The ceiling of that, in turn with the rest: two processes that know nothing of each
  other and share nothing but the memory, one core each, with 16 lanes each. What two
  cores can give differs by machine and day.
- One vmapped `solve_equilibrium` of 64 lanes over 64 calls of one.
"""

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._cantilever import first_lane, solve
from benchmarks._paper import CELLS, MeasuredBeam, measured_beam
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import ROOT, interleave, median_ms, run_process
from softcal_jax.calibration import CalibrationProblem, Evaluator
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Workers, usable_cores

LANES = (1, 2, 4, 16, 64)
ROUNDS, REPEATS = 3, 5
STEP = 0.05
"""How far the parameters move from the equilibria that the lanes start from [-]."""

SINGLES = 64
COMMAND = (sys.executable, "-m", "benchmarks.batch")
READY = "ready"
OF_TWO = 16
"""Lanes of each of two processes."""

GOALS = {
    "throughput_16_lanes_vs_1_core": Goal("at least", 1.7),
    "throughput_16_lanes_vs_two_processes": Goal("at least", 0.95),
}


def run(options: Options) -> Outcome:
    """All cores and one in turn; then one call against many."""
    samples: dict[str, list[float]] = {}
    for i in range(ROUNDS):
        options.say(f"evaluations on all cores and on one, {i + 1} of {ROUNDS}")
        for which in ("all", "one"):
            by_lanes = json.loads(run_process([*COMMAND, which]).splitlines()[-1])
            for lanes, seconds in by_lanes.items():
                samples.setdefault(f"{which}_{lanes}_s", []).extend(seconds)
        samples.setdefault(f"two_{OF_TWO}_s", []).extend(seconds_of_two())
    figures: dict[str, Figure] = {"cores": usable_cores()}
    rows = []
    for n in LANES:
        whole, one = (statistics.median(samples[f"{k}_{n}_s"]) for k in ("all", "one"))
        figures[f"throughput_{n}_lanes_vs_1_core"] = one / whole
        figures[f"ms_per_lane_{n}_lanes"] = 1e3 * whole / n
        rows.append([str(n), f"{1e3 * one / n:.2f}", f"{1e3 * whole / n:.2f}"])
        rows[-1].append(f"{one / whole:.2f}")
    two, whole = (statistics.median(samples[f"{k}_{OF_TWO}_s"]) for k in ("two", "all"))
    figures["throughput_16_lanes_vs_two_processes"] = two / 2.0 / whole
    options.say("one call against many")
    times = one_call_and_many(measured_beam(CELLS, plane="xy"), SINGLES)
    samples |= {f"{name}_s": seconds for name, seconds in times.items()}
    share = median_ms(times["batch"]) / median_ms(times["singles"])
    figures[f"batch{SINGLES}_over_{SINGLES}_singles"] = share
    columns = ["lanes", "one core [ms a lane]", "all cores [ms a lane]", "throughput"]
    table = Table("Evaluations, medians", columns, rows)
    return Outcome(figures, samples, GOALS, [table])


def loaded(measured: MeasuredBeam, n: int) -> CalibrationProblem:
    """A calibration of n configurations: those of the beam, each with its own weight.

    Args:
        measured: The beam of Sec. V.
        n: Number of configurations.
    """
    poses = measured.problem.configurations
    n_c = poses.gravity.shape[0]
    lanes = jax.tree.map(lambda leaf: leaf[np.arange(n) % n_c], poses)
    weight = jnp.linspace(0.8, 1.2, n)[:, None]
    lanes = eqx.tree_at(lambda c: c.gravity, lanes, weight * lanes.gravity)
    # The noise of the beam is of its own configurations.
    problem = measured.problem.with_noise(None)
    return eqx.tree_at(lambda p: p.configurations, problem, lanes)


def evaluation_seconds(
    measured: MeasuredBeam,
    n: int,
    repeats: int,
    ready: Callable[[], object] = lambda: None,
) -> list[float]:
    """Times of evaluations of n lanes on the cores of this process [s].

    Args:
        measured: The beam of Sec. V.
        n: Number of lanes.
        repeats: Timed evaluations.
        ready: Called before the first of them, when everything is compiled.
    """
    with Workers(measured.problem.model, n) as workers:
        evaluate = Evaluator(loaded(measured, n), workers)
        before = evaluate.from_rest(measured.target)
        z, u = measured.target + STEP, before.equilibrium.displacement
        call = lambda: jax.block_until_ready(evaluate(z, u))
        if not bool(call().ok):
            raise RuntimeError(f"a lane of {n} has no equilibrium.")
        ready()
        return interleave({"evaluate": call}, repeats)["evaluate"]


def seconds_of_two() -> list[float]:
    """Times of evaluations in two processes at once, each on a core of its own [s]."""
    both = [
        subprocess.Popen(
            [*COMMAND, core],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        for core in ("first", "last")
    ]
    for process in both:
        assert process.stdout is not None
        if process.stdout.readline().strip() != READY:
            raise RuntimeError("one of two processes has failed; its errors are above.")
    for process in both:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    seconds: list[float] = []
    for process in both:
        seconds += json.loads(process.communicate()[0])
    return seconds


def one_call_and_many(measured: MeasuredBeam, n: int) -> dict[str, list[float]]:
    """Times of one vmapped solve of n lanes, and of n solves [s]."""
    model = measured.problem.space.model_at(measured.problem.model, measured.target)
    lanes = loaded(measured, n).configurations
    singles = [first_lane(_from(lanes, i)) for i in range(n)]
    batched = eqx.filter_jit(
        lambda model, lanes: jax.vmap(lambda lane: solve(model, lane))(lanes)
    )
    calls: dict[str, Callable[[], object]] = {
        "batch": lambda: jax.block_until_ready(batched(model, lanes)),
        "singles": lambda: [
            jax.block_until_ready(solve(model, lane)) for lane in singles
        ],
    }
    return interleave(calls, REPEATS)


def _from(lanes: ConfigurationArrays, i: int) -> ConfigurationArrays:
    return jax.tree.map(lambda leaf: leaf[i:], lanes)


def _told_to_begin() -> None:
    """Wait for the other of two processes."""
    print(READY, flush=True)
    sys.stdin.readline()


if __name__ == "__main__":
    which, cores = sys.argv[1], sorted(os.sched_getaffinity(0))
    if which != "all":
        # Before anything computes, so that every pool of threads has one.
        os.sched_setaffinity(0, {cores[-1] if which == "last" else cores[0]})
    jax.config.update("jax_enable_x64", True)
    beam = measured_beam(CELLS, plane="xy")
    if which in ("first", "last"):
        times = evaluation_seconds(beam, OF_TWO, 2 * REPEATS, _told_to_begin)
    else:
        times = {n: evaluation_seconds(beam, n, REPEATS) for n in LANES}
    print(json.dumps(times))
