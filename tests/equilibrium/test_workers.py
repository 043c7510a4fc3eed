"""Lanes side by side on several threads, against the same lanes one after the other."""

from threading import Barrier, BrokenBarrierError, Event, Thread

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.configurations import Configuration, Support, configuration_arrays
from softcal_jax.equilibrium import Batch, Workers, build_model, solve_equilibrium
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

MODULI = np.linspace(2e5, 9e5, 7)


@pytest.fixture(scope="module")
def cantilever():
    mesh = beam(0.1, 0.02, 0.015, (6, 2, 2), order=2)
    model = build_model(mesh, Corotational(Isotropic(5e5, 0.3)), density=1000.0)
    own_weight = Configuration("weight", (Support("x_min"),), gravity=(0, 0, -9.81))
    lane = configuration_arrays(mesh, [own_weight])
    return model, lane_of(lane)


@eqx.filter_jit
def _solve(model, configuration, E):
    model = model.with_law(Corotational(Isotropic(E, 0.3)))
    return solve_equilibrium(model, configuration)


def solve(cantilever):
    """Equilibrium for one modulus, as a function of the solver and the modulus."""
    model, configuration = cantilever

    def one(solver, E):
        model_there = eqx.tree_at(lambda m: m.solver, model, solver)
        found = _solve(model_there, configuration, E)
        return jax.block_until_ready(found.displacement), bool(found.converged)

    return one


def mapped(workers, function, lanes, program):
    """Results of one batch."""

    def job():
        return (yield Batch(function, list(lanes), program))

    return workers.end_of(job())


def test_threads_give_what_one_gives_in_the_same_order(cantilever):
    model, one = cantilever[0], solve(cantilever)
    moduli = jnp.asarray(MODULI)
    serial = [one(model.solver, E) for E in moduli]
    with Workers(model, len(moduli), 3) as workers:
        assert workers.n == 3
        for _ in range(3):  # threads meet in another order each time
            for (u, ok), (expected, _) in zip(
                mapped(workers, one, moduli, "solve"), serial, strict=True
            ):
                assert ok
                np.testing.assert_allclose(u, expected, rtol=0, atol=1e-13)
    # The solver of the model still plans for all cores.
    u, ok = one(model.solver, moduli[0])
    assert ok
    np.testing.assert_array_equal(u, serial[0][0])


def test_an_error_in_a_lane_is_raised_and_no_solver_is_lost(cantilever):
    def fails(solver, lane):
        if lane == 2:
            raise ValueError("lane 2")
        return lane

    with Workers(cantilever[0], 8, 2) as workers:
        for _ in range(4):
            with pytest.raises(ValueError, match="lane 2"):
                mapped(workers, fails, range(5), "fails")
        assert mapped(workers, fails, [0, 1, 3], "fails") == [0, 1, 3]


def test_the_first_lane_of_a_new_program_goes_ahead_alone(cantilever):
    """It compiles for all; afterwards none waits for another, in a new context too."""
    meeting = Barrier(2, timeout=20.0)
    meet = lambda solver, lane: meeting.wait() >= 0
    with Workers(cantilever[0], 8, 2) as workers:
        # Two that wait for each other would wait for ever if one went ahead.
        assert mapped(workers, lambda _, lane: lane, [7], "meeting") == [7]
        assert mapped(workers, meet, range(2), "meeting") == [True, True]
    with Workers(cantilever[0], 8, 2) as workers:
        assert mapped(workers, meet, range(2), "meeting") == [True, True]
        impatient = Barrier(2, timeout=0.2)
        with pytest.raises(BrokenBarrierError):
            mapped(workers, lambda *_: impatient.wait(), range(2), "another")


def counting(first, n_batches, seen):
    """A job of batches of two lanes each; it returns the sum of all lanes."""
    total = 0
    for i in range(n_batches):
        total += sum((yield Batch(lambda _, lane: lane, [first + i, 1], "count")))
        seen.append(first)
    return total


@pytest.mark.parametrize("n", [1, 2])
def test_jobs_that_end_leave_their_place_to_the_next(cantilever, n):
    """Each gets its own results, whatever else is under way, and few are at once."""
    seen, told = [], []
    firsts = range(0, 100, 10)
    with Workers(cantilever[0], 8, n) as workers:
        jobs = [counting(first, 3, seen) for first in firsts]
        ends = workers.ends(jobs, lambda *end: told.append(end))
    assert ends == [3 * first + 3 + 3 for first in firsts]
    assert sorted(told) == list(enumerate(ends))
    assert sorted(seen) == sorted(3 * list(firsts))
    # The first has long ended when the last begins.
    assert max(i for i, first in enumerate(seen) if first == 0) < seen.index(90)
    if n == 1:
        assert [i for i, _ in told] == list(range(10))


def test_a_job_without_lanes_to_run_ends_at_once(cantilever):
    def nothing():
        return 7
        yield

    with Workers(cantilever[0], 8, 2) as workers:
        assert workers.ends([nothing(), nothing()]) == [7, 7]


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
    with pytest.raises(ValueError, match=r"'pardiso-host'.* has 1: set PJRT_NPROC=2"):
        build_model(mesh, law, density=1000.0, solver="pardiso-host")
