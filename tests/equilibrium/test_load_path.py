"""States along the load, past limit points: a balloon against its closed form.

A thick, nearly incompressible neo-Hookean sphere carries at most p = 0.81 mu, at an
inner stretch of 1.9 (`neo_hookean_sphere`).
"""

from concurrent.futures import CancelledError

import jax
import numpy as np
import pytest
from mechanisms import TIGHT, arrays
from problems import neo_hookean_sphere
from scipy.optimize import fminbound
from test_pressure_sphere import ball, inflated, solved
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.configurations import ImposedDisplacement, ImposedForce
from softcal_jax.equilibrium import (
    RESULTS,
    LoadPath,
    check_converged,
    solve_equilibrium,
    trace_equilibria,
)

MU = 1.0 / 3.0
TOP = np.asarray(fminbound(lambda s: -neo_hookean_sphere(s).pressure, 1.2, 3.0)).item()
LARGEST = neo_hookean_sphere(TOP).pressure * MU
FULL = 1.2 * LARGEST
"""Pressure at full load, a fifth more than the sphere can carry."""
MESH_ERROR = 0.03
"""Of the pressure at two cells: 2.9 % at small stretches, 0.7 % at the limit point."""


def model():
    return ball(2, nu=0.4999)


@pytest.fixture(scope="module")
def lane():
    return arrays(model(), inflated(chamber=ImposedForce(FULL)))


@pytest.fixture(scope="module")
def traced(lane):
    """A path, and the programs that it took."""
    with Compilations() as seen:
        settings = LoadPath(states=18, first=0.2)
        path = trace_equilibria(model(), lane, settings, settings=TIGHT)
    return path, seen.programs


@pytest.fixture(scope="module")
def path(traced):
    return traced[0]


def test_the_first_step_and_the_others_share_a_program(traced):
    assert traced[1].count("jit(_step)") == 1


def stretches(path):
    """Inner stretch by the volume of the chamber."""
    return np.cbrt(1.0 + path.readings[:, 0, 0] / (4.0 / 3.0 * np.pi))


def test_the_path_is_the_closed_form_on_both_sides_of_the_limit(path):
    inner_stretch = stretches(path)
    assert path.load[0] == 0.0
    assert inner_stretch.max() > 2.4
    exact = [neo_hookean_sphere(s).pressure * MU for s in inner_stretch]
    np.testing.assert_allclose(FULL * path.load, exact, rtol=MESH_ERROR, atol=1e-12)


def test_the_limit_point_is_where_the_closed_form_has_it(path):
    np.testing.assert_allclose(FULL * path.load.max(), LARGEST, rtol=0.01)
    at_top = stretches(path)[np.argmax(path.load)]
    # The states about it are a tenth of the stretch apart.
    np.testing.assert_allclose(at_top, TOP, rtol=0.1)
    assert bool(path.result == RESULTS.limit_point)


def test_stability_is_lost_at_the_limit_point(path):
    """Under a given pressure; a given volume is stable everywhere."""
    top = int(np.argmax(path.load))
    np.testing.assert_array_equal(path.n_negative[:top], 0)
    np.testing.assert_array_equal(path.n_negative[top + 1 :], 1)


@pytest.mark.parametrize("state", [3, -1])
def test_a_state_is_that_of_its_volume_imposed(path, state):
    volume = float(path.readings[state, 0, 0])
    chamber = ImposedDisplacement(volume)
    solution, pressure, _, _ = solved(model(), chamber=chamber)
    # Both are solved to 1e-12 of the forces.
    np.testing.assert_allclose(pressure, FULL * path.load[state], rtol=1e-8)
    np.testing.assert_allclose(
        solution.displacement, path.displacement[state], rtol=0, atol=1e-7
    )


def test_an_imposed_volume_reaches_the_full_load():
    """Past the largest pressure, since it is not the pressure that is given."""
    growth = 4.0 / 3.0 * np.pi * (2.5**3 - 1.0)
    lane = arrays(model(), inflated(chamber=ImposedDisplacement(growth)))
    path = trace_equilibria(model(), lane, LoadPath(first=0.5))
    assert bool(path.result == RESULTS.converged)
    assert path.load[-1] == 1.0
    _, pressure, _, _ = solved(model(), chamber=ImposedDisplacement(growth))
    np.testing.assert_allclose(path.multipliers[-1, 0], pressure, rtol=1e-6)
    # The path passes the largest pressure, and the states on both sides are stable.
    assert path.multipliers.max() > pressure
    np.testing.assert_array_equal(path.n_negative, 0)


def test_a_limit_point_is_named_as_one(lane):
    solution = solve_equilibrium(model(), lane)
    assert bool(solution.result == RESULTS.largest_pressure)
    assert int(solution.n_negative) == 1
    # Newton's iterations are used up before the load steps are the smallest.
    share = float(solution.load_reached)
    assert LARGEST / FULL * (1.0 - MESH_ERROR) - 0.01 < share
    assert share < LARGEST / FULL * (1.0 + MESH_ERROR)
    with pytest.raises(RuntimeError) as error:
        check_converged(solution, ("balloon",))
    carried = f"{100.0 * share:.3g} % of the load"
    assert says(
        error.value, "'balloon': a limit point", carried, "1 negative eigenvalue"
    )
    assert "raise max_steps" not in str(error.value)


def test_a_path_is_refused_where_it_cannot_be_followed(lane):
    with pytest.raises(ValueError, match="outside of jit"):
        jax.jit(lambda c: trace_equilibria(model(), c).load)(lane)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"states": 0}, "states .*least 1, got 0"),
        ({"first": 1.5}, "first .*, got 1.5"),
        ({"largest": -1.0}, "largest .*positive, got -1"),
    ],
)
def test_bad_settings_of_a_path(wrong, message):
    with pytest.raises(ValueError, match=message):
        LoadPath(**wrong)


def test_a_path_ends_where_its_check_raises(lane):
    """So Ctrl-C need not wait for its end, in a thread."""
    states = []

    def check():
        states.append(None)
        if len(states) == 3:
            raise CancelledError

    with pytest.raises(CancelledError):
        trace_equilibria(model(), lane, settings=TIGHT, check=check)
    assert len(states) == 3
