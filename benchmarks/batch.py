"""Batches of configurations: on all cores, and as one call.

The 525-node beam of Sec. V under loads of its own in each lane.

- Throughput of evaluations (equilibria, errors, W_ep, as a step of a calibration takes
  them) of 1 to 64 lanes side by side on all cores, over that of one core: processes of
  their own, one after the other, of which the second may use a single core. Each lane
  starts from the equilibria of parameters that are a step away.
- The ceiling of that, in turn with the rest: two processes that know nothing of each
  other and share nothing but the memory, one core each, with 16 lanes each. What two
  cores can give differs by machine and day.
- `map_lanes` over the devices of `use_cores`: 16 equilibria, and their gradient by the
  parameters, over a `vmap` on one device and over two processes as above. More devices
  than cores tell what each costs, and not what it gains. Once more where twelve lanes
  begin at their equilibria, so that the first four take about five times as long.
- One vmapped `solve_equilibrium` of 64 lanes over 64 calls of one.

`--count` runs one part: `evaluations`, `devices` or `call`.
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
from softcal_jax import use_compilation_cache
from softcal_jax.calibration import Evaluator
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Workers,
    map_lanes,
    solve_equilibrium,
    usable_cores,
    use_cores,
)
from softcal_jax.unknowns import Problem

LANES = (1, 2, 4, 16, 64)
COUNTS = {"evaluations": 3, "devices": 3, "call": 1}
"""Parts, and how many rounds of each."""

REPEATS = 5
STEP = 0.05
"""How far the parameters move from the equilibria that the lanes start from [-]."""

SINGLES = 64
COMMAND = (sys.executable, "-m", "benchmarks.batch")
READY = "ready"
OF_TWO = 16
"""Lanes of each of two processes."""

DEVICES = (2, 4, 8)
FROM_REST = 4
"""Lanes that begin at rest, while the others begin at their equilibria."""

GOALS = {
    "throughput_16_lanes_vs_1_core": Goal("at least", 1.7),
    "throughput_16_lanes_vs_two_processes": Goal("at least", 0.95),
    "devices_value_vs_1_device": Goal("at least", 1.9),
    "devices_gradient_vs_1_device": Goal("at least", 1.9),
    "devices_value_vs_two_processes": Goal("at least", 0.95),
    "devices_gradient_vs_two_processes": Goal("at least", 0.95),
}


def run(options: Options) -> Outcome:
    """The parts that are asked for."""
    counts = options.counts or COUNTS
    parts = {"evaluations": evaluations, "devices": on_devices, "call": one_call}
    outcomes = [parts[name](options, count) for name, count in counts.items()]
    figures = {k: v for outcome in outcomes for k, v in outcome.figures.items()}
    samples = {k: v for outcome in outcomes for k, v in outcome.samples.items()}
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    tables = [table for outcome in outcomes for table in outcome.tables]
    return Outcome(figures, samples, goals, tables)


def evaluations(options: Options, rounds: int) -> Outcome:
    """Evaluations on all cores, on one, and in two processes, in turn."""
    samples: dict[str, list[float]] = {}
    for i in range(rounds):
        options.say(f"evaluations on all cores and on one, {i + 1} of {rounds}")
        for which in ("all", "one"):
            by_lanes = json.loads(run_process([*COMMAND, which]).splitlines()[-1])
            for lanes, seconds in by_lanes.items():
                samples.setdefault(f"{which}_{lanes}_s", []).extend(seconds)
        for times in of_two("evaluations"):
            samples.setdefault(f"two_{OF_TWO}_s", []).extend(times["evaluate"])
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
    columns = ["lanes", "one core [ms a lane]", "all cores [ms a lane]", "throughput"]
    return Outcome(figures, samples, {}, [Table("Evaluations, medians", columns, rows)])


def on_devices(options: Options, rounds: int) -> Outcome:
    """`map_lanes` on devices, `vmap` on one, and two processes, in turn."""
    samples: dict[str, list[float]] = {}
    for i in range(rounds):
        options.say(f"lanes on devices, {i + 1} of {rounds}")
        for n in DEVICES:
            text = run_process([*COMMAND, "devices", str(n)])
            for name, seconds in json.loads(text.splitlines()[-1]).items():
                samples.setdefault(f"devices_{n}_{name}_s", []).extend(seconds)
        for times in of_two("lanes"):
            for name, seconds in times.items():
                samples.setdefault(f"processes_{name}_s", []).extend(seconds)
    median = lambda name: statistics.median(samples[f"{name}_s"])
    figures: dict[str, Figure] = {}
    rows = []
    for what in ("value", "gradient"):
        two = median(f"devices_2_{what}_mapped")
        figures[f"devices_{what}_ms_per_lane"] = 1e3 * two / OF_TWO
        figures[f"devices_{what}_vs_two_processes"] = (
            median(f"processes_{what}_alone") / 2.0 / two
        )
        for n in DEVICES:
            alone, mapped = (
                median(f"devices_{n}_{what}_{k}") for k in ("alone", "mapped")
            )
            vs_one = "vs_1_device" if n == 2 else f"of_{n}_vs_1_device"
            figures[f"devices_{what}_{vs_one}"] = alone / mapped
            row = [what, str(n), f"{1e3 * alone / OF_TWO:.2f}"]
            rows.append([*row, f"{1e3 * mapped / OF_TWO:.2f}", f"{alone / mapped:.2f}"])
    figures["devices_uneven_vs_1_device"] = median("devices_2_uneven_alone") / median(
        "devices_2_uneven_mapped"
    )
    columns = ["", "devices", "one [ms a lane]", "all [ms a lane]", "times as fast"]
    return Outcome(figures, samples, {}, [Table("Lanes on devices", columns, rows)])


def one_call(options: Options, repeats: int) -> Outcome:
    """One vmapped call against many, in rounds of five."""
    options.say("one call against many")
    beam = measured_beam(CELLS, plane="xy")
    times = one_call_and_many(beam, SINGLES, repeats * REPEATS)
    share = median_ms(times["batch"]) / median_ms(times["singles"])
    figures: dict[str, Figure] = {f"batch{SINGLES}_over_{SINGLES}_singles": share}
    return Outcome(figures, {f"{name}_s": seconds for name, seconds in times.items()})


def lane_seconds(
    measured: MeasuredBeam, repeats: int, ready: Callable[[], object] = lambda: None
) -> dict[str, list[float]]:
    """Times of 16 lanes by `map_lanes` and by `vmap` on one device, in turn [s].

    Args:
        measured: The beam of Sec. V.
        repeats: Timed calls of each.
        ready: Called before the first of them, when everything is compiled.
    """
    space, z = measured.problem.space, measured.target
    model, lanes = measured.problem.model, loaded(measured, OF_TWO).configurations

    def shape(model, lane, z):
        configuration, guess = lane
        body = space.model_at(model, z)
        return solve_equilibrium(body, configuration, guess=guess).displacement

    @eqx.filter_jit
    def alone(model, lanes, z):
        return jax.vmap(lambda lane: shape(model, lane, z))(lanes)

    mapped = lambda lanes, z: map_lanes(shape, model, lanes, z)
    apart = lambda lanes, z: alone(model, lanes, z)
    even = lanes, jnp.zeros((OF_TWO, model.n_points, 3))
    near = apart(even, z).at[:FROM_REST].set(0.0)
    uneven = lanes, near
    slope = lambda of: jax.jit(jax.value_and_grad(lambda z: jnp.sum(of(even, z) ** 2)))
    by_z, by_z_apart = slope(mapped), slope(apart)
    calls: dict[str, Callable[[], object]] = {
        "value_alone": lambda: apart(even, z),
        "gradient_alone": lambda: by_z_apart(z),
    }
    if len(jax.devices()) > 1:
        calls |= {
            "value_mapped": lambda: mapped(even, z),
            "gradient_mapped": lambda: by_z(z),
            "uneven_alone": lambda: apart(uneven, z),
            "uneven_mapped": lambda: mapped(uneven, z),
        }
    calls = {name: _waiting(call) for name, call in calls.items()}
    for call in calls.values():
        call()
    ready()
    return interleave(calls, repeats)


def _waiting(call: Callable[[], object]) -> Callable[[], object]:
    return lambda: jax.block_until_ready(call())


def loaded(measured: MeasuredBeam, n: int) -> Problem:
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


def of_two(what: str) -> list[dict[str, list[float]]]:
    """What two processes at once measure, each on a core of its own.

    Args:
        what: "evaluations" or "lanes".
    """
    both = [
        subprocess.Popen(
            [*COMMAND, core, what],
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
    return [json.loads(process.communicate()[0]) for process in both]


def one_call_and_many(
    measured: MeasuredBeam, n: int, repeats: int
) -> dict[str, list[float]]:
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
    return interleave(calls, repeats)


def _from(lanes: ConfigurationArrays, i: int) -> ConfigurationArrays:
    return jax.tree.map(lambda leaf: leaf[i:], lanes)


def _told_to_begin() -> None:
    """Wait for the other of two processes."""
    print(READY, flush=True)
    sys.stdin.readline()


if __name__ == "__main__":
    which, cores = sys.argv[1], sorted(os.sched_getaffinity(0))
    if which not in ("all", "devices"):
        # Before anything computes, so that every pool of threads has one.
        os.sched_setaffinity(0, {cores[-1] if which == "last" else cores[0]})
    jax.config.update("jax_enable_x64", True)
    if which == "devices":
        use_cores(int(sys.argv[2]))
    use_compilation_cache(quickly=False)
    beam = measured_beam(CELLS, plane="xy")
    if which == "devices":
        times = lane_seconds(beam, REPEATS)
    elif which in ("first", "last") and sys.argv[2] == "lanes":
        times = lane_seconds(beam, REPEATS, _told_to_begin)
    elif which in ("first", "last"):
        begin = _told_to_begin
        times = {"evaluate": evaluation_seconds(beam, OF_TWO, 2 * REPEATS, begin)}
    else:
        times = {n: evaluation_seconds(beam, n, REPEATS) for n in LANES}
    print(json.dumps(times))
