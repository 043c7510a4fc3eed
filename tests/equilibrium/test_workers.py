"""Lanes side by side on several threads, against the same lanes one after the other."""

import signal
import time
from dataclasses import replace
from functools import partial
from threading import Barrier, BrokenBarrierError, Event, Thread

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from benchmarks._compilations import Compilations
from softcal_jax.configurations import Configuration, Support, configuration_arrays
from softcal_jax.equilibrium import (
    Program,
    Workers,
    build_model,
    solve_equilibrium,
    usable_cores,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam

MODULI = np.linspace(2e5, 9e5, 7)
OF_PARDISO = 4  # MKL_DOMAIN_PARDISO in the headers of MKL


@pytest.fixture(scope="module")
def cantilever():
    mesh = beam(0.1, 0.02, 0.015, (6, 2, 2), order=2)
    model = build_model(mesh, NeoHookean(5e5, 0.3), density=1000.0)
    own_weight = Configuration("weight", (Support("x_min"),), gravity=(0, 0, -9.81))
    lane = configuration_arrays(mesh, [own_weight])
    return model, lane_of(lane)


@eqx.filter_jit
def _solve(model, configuration, E):
    model = model.with_law(NeoHookean(E, 0.3))
    return solve_equilibrium(model, configuration)


def test_threads_give_what_one_gives_in_the_same_order(cantilever):
    model, moduli = cantilever[0], jnp.asarray(MODULI)
    program = Program(_solve, *cantilever)
    solve = lambda E: program.run(model.solver, (E,))
    serial = [solve(E) for E in moduli]
    with Workers(model, len(moduli), 3) as workers:
        assert workers.n == 3
        for _ in range(3):  # threads meet in another order each time
            solutions = workers.map(program, [(E,) for E in moduli])
            for solution, expected in zip(solutions, serial, strict=True):
                assert solution.converged
                np.testing.assert_allclose(
                    solution.displacement, expected.displacement, rtol=0, atol=1e-13
                )
    # The solver of the model still plans for all cores.
    again = solve(moduli[0])
    assert again.converged
    np.testing.assert_array_equal(again.displacement, serial[0].displacement)


def same(lane):
    return lane


def lanes(*values):
    return [(value,) for value in values]


def test_all_cores_share_large_factorizations(cantilever):
    """One after the other; small ones, of several lanes, have a core each."""
    model, lane = cantilever
    if "mkl" not in model.solver.name:
        pytest.skip("another solver on this platform")
    from pardiso_mkl_jax._mkl_loader import libmkl_rt as mkl

    solver = model.solver
    large = replace(solver, work=np.asarray(1e4))
    threads = lambda: mkl.MKL_Domain_Get_Max_Threads(OF_PARDISO)
    # What PARDISO reports differs by thread; a program serves all of them.
    assert jax.tree.structure(large) == jax.tree.structure(solver)
    program = Program(_solve, *cantilever)
    serial = program.run(solver, (MODULI[0],))
    cores = threads()  # of a test, one
    mkl.MKL_Domain_Set_Num_Threads(2, OF_PARDISO)
    try:
        with solver.side_by_side():
            assert threads() == 1
        with large.side_by_side():
            assert threads() == 2
        of_large = eqx.tree_at(lambda m: m.solver, model, large)
        with Workers(of_large, 4, 2) as workers:
            lanes = 4 * [(MODULI[0],)]
            solutions = workers.map(Program(_solve, of_large, lane), lanes)
    finally:
        mkl.MKL_Domain_Set_Num_Threads(cores, OF_PARDISO)
    for solution in solutions:
        np.testing.assert_allclose(
            solution.displacement, serial.displacement, rtol=0, atol=1e-13
        )


def test_an_error_in_a_lane_is_raised_and_no_solver_is_lost(cantilever):
    def fails(lane):
        if lane >= 2:
            raise ValueError(f"lane {lane}")
        return lane

    with Workers(cantilever[0], 8, 2) as workers:
        for _ in range(4):  # the first of both, however they meet
            with pytest.raises(ValueError, match="lane 2"):
                workers.map(Program(fails), lanes(0, 1, 2, 3, 4))
        assert workers.map(Program(fails), lanes(0, 1, -3)) == [0, 1, -3]


def test_the_first_lane_of_a_new_program_goes_ahead_alone(cantilever):
    """It compiles for all; afterwards none waits for another, in a new context too."""
    meeting, alone = Barrier(2, timeout=20.0), lanes(np.zeros(()))
    both = lanes(np.ones(()), np.ones(()))

    def meet(lane):
        return lane == 0 or meeting.wait() >= 0

    with Workers(cantilever[0], 8, 2) as workers:
        # Two that wait for each other would wait for ever if one went ahead.
        assert workers.map(Program(meet), alone) == [True]
        assert workers.map(Program(meet), both) == [True, True]
    with Workers(cantilever[0], 8, 2) as workers:
        assert workers.map(Program(meet), both) == [True, True]
        impatient = Barrier(2, timeout=0.2)
        with pytest.raises(BrokenBarrierError):
            workers.map(Program(lambda lane: impatient.wait()), lanes(0, 1))


@pytest.mark.skipif(usable_cores() < 2, reason="one core compiles when it is due")
def test_what_is_compiled_ahead_is_not_compiled_when_it_is_due(cantilever):

    @eqx.filter_jit
    def fails_above(most, lane):
        if lane.size > most:
            raise ValueError(f"{lane.size} values")
        return jnp.sum(lane**3)

    program = Program(fails_above, 5)
    due, too_large = lanes(jnp.arange(4.0), jnp.ones(4)), lanes(jnp.ones(6))
    with Workers(cantilever[0], 8, 2) as workers:
        begun = Event()
        workers.ahead(lambda: (Program(fails_above, 5), too_large))
        workers.ahead(lambda: (program, due))
        # One after the other: this comes when that is compiled.
        workers.ahead(lambda: (program, [begun.set()][:0]))
        assert begun.wait(20.0)
        with Compilations() as seen:
            assert list(map(float, workers.map(program, due))) == [36.0, 4.0]
        assert seen.programs == []
        with pytest.raises(ValueError, match="6 values"):
            workers.map(Program(fails_above, 5), too_large)


def counting(workers, first, n_maps, seen):
    """Sum of the lanes of some calls, of two lanes each."""
    total = 0
    for i in range(n_maps):
        total += sum(workers.map(Program(same), lanes(first + i, 1)))
        seen.append(first)
    return total


@pytest.mark.parametrize("n", [1, 2])
def test_runs_that_end_leave_their_place_to_the_next(cantilever, n):
    """Each gets its own results, whatever else is under way, and few are at once."""
    seen, reported = [], []
    firsts = range(0, 100, 10)
    with Workers(cantilever[0], 8, n) as workers:
        runs = [partial(counting, workers, first, 3, seen) for first in firsts]
        ends = workers.side_by_side(runs, lambda *end: reported.append(end))
    assert ends == [3 * first + 3 + 3 for first in firsts]
    assert reported == list(enumerate(ends))
    assert sorted(seen) == sorted(3 * list(firsts))
    # The first has long ended when the last begins.
    assert max(i for i, first in enumerate(seen) if first == 0) < seen.index(90)


def test_one_run_at_a_time_computes_between_its_lanes(cantilever):
    """So what they share needs no locks, and what they compile is compiled once."""
    computing = []

    def run(workers):
        for _ in range(5):
            computing.append(1)
            assert len(computing) == 1
            time.sleep(0.001)
            computing.pop()
            workers.map(Program(same), lanes(0, 1))

    with Workers(cantilever[0], 8, 3) as workers:
        workers.side_by_side([partial(run, workers)] * 8)


@pytest.mark.parametrize("n", [1, 2])
def test_the_error_of_the_first_run_is_raised_and_the_others_stop(cantilever, n):
    begun = []

    def run(workers, i):
        begun.append(i)
        for _ in range(3 if i == 1 else 10_000 * (i > 1)):
            workers.map(Program(same), lanes(i))
        if i in (1, 2):
            raise ValueError(f"run {i}")

    with Workers(cantilever[0], 8, n) as workers:
        with pytest.raises(ValueError, match="run 1"):
            workers.side_by_side(partial(run, workers, i) for i in range(100))
        assert workers.map(Program(same), lanes(3, 4)) == [3, 4]
    assert len(begun) < 10


def test_an_interrupt_stops_runs_between_lanes(cantilever):
    """As Ctrl-C does, which reaches the thread that waits for them."""
    ends = []

    def run(workers, i):
        for k in range(3 if i == 0 else 10_000):
            ends.append(workers.map(Program(same), lanes(i, k)))
        return i

    def ctrl_c(i, _):
        signal.raise_signal(signal.SIGINT)

    with Workers(cantilever[0], 8, 2) as workers:
        runs = [partial(run, workers, i) for i in range(50)]
        with pytest.raises(KeyboardInterrupt):
            workers.side_by_side(runs, ctrl_c)
        assert [0, 2] in ends
        stopped = len(ends)
        assert workers.map(Program(same), lanes(3, 4)) == [3, 4]
    assert len(ends) == stopped < 20_000


@pytest.mark.parametrize("n", [1, 2])
def test_runs_within_runs_end(cantilever, n):
    """Also in workers of their own, in more threads than there are."""

    def inner(workers, i):
        return sum(workers.map(Program(same), lanes(i, i)))

    def outer(workers, i):
        with Workers(cantilever[0], 2, n) as others:
            first = inner(others, i)
        return first + sum(
            workers.side_by_side(partial(inner, workers, i) for _ in range(4))
        )

    with Workers(cantilever[0], 8, n) as workers:
        runs = [partial(outer, workers, i) for i in range(6)]
        assert workers.side_by_side(runs) == [10 * i for i in range(6)]


def test_a_run_without_lanes_ends_at_once(cantilever):
    with Workers(cantilever[0], 8, 2) as workers:
        assert workers.side_by_side([lambda: 7, lambda: 7]) == [7, 7]
        assert workers.side_by_side([]) == workers.map(Program(same), []) == []


def test_threads_of_a_program_take_turns(cantilever):
    """Else one would change the number of PARDISO's threads under the other."""
    entered = Event()

    def other():
        with Workers(cantilever[0], 2, 2):
            entered.set()

    with Workers(cantilever[0], 2, 2):
        with Workers(cantilever[0], 2, 2):
            pass  # the thread whose turn it is need not wait for itself
        thread = Thread(target=other)
        thread.start()
        assert not entered.wait(0.5)
    thread.join(20.0)
    assert entered.is_set()


def test_there_are_no_more_threads_than_lanes(cantilever):
    model = cantilever[0]
    assert Workers(model, 1, 4).n == 1
    assert Workers(model, 3, 8).n == 3
    with pytest.raises(ValueError, match="at least 1, got 0"):
        Workers(model, 3, 0)


def test_solvers_behind_a_callback_take_one_thread(cantilever):
    """Two of their programs at once can wait for each other for ever."""
    pytest.importorskip("pypardiso", reason="not installed on this platform")
    mesh, law = cantilever[0].mesh, cantilever[0].law
    model = build_model(mesh, law, density=1000.0, solver="pardiso-host")
    assert Workers(model, 8, 4).n == 1


def test_a_callback_without_a_thread_is_refused(cantilever, monkeypatch):
    """It would wait for ever."""
    monkeypatch.setenv("PJRT_NPROC", "1")
    mesh, law = cantilever[0].mesh, cantilever[0].law
    with pytest.raises(ValueError, match=r"'pardiso-host'.* 1: set PJRT_NPROC=2"):
        build_model(mesh, law, density=1000.0, solver="pardiso-host")
