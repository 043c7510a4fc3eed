"""The benchmark of reliability: its oracle, its bad inputs, and its small parts."""

import signal
import sys
import time

import jax.numpy as jnp
import numpy as np
import pytest
from wording import says

from benchmarks import _cli, _kills, _oracle, reliability
from benchmarks._bodies import KINDS as BODIES, draw
from benchmarks._honesty import judge
from benchmarks._malformed_inputs import faults
from benchmarks._malformed_run import names
from softcal_jax.equilibrium import internal_force, solve_equilibrium

MEAN = "mean-dilatation"


def stretch(law, s, **constants):
    """Stress P [Pa] of a law at the principal stretches s, by the oracle."""
    c = {name: np.full(1, value) for name, value in constants.items()}
    F = np.diag(s)[:, :, None, None]
    return _oracle.LAWS[law](c).gradient([F, None])[0][:, :, 0, 0]


def test_the_oracles_rubbers_keep_to_their_closed_forms():
    """Bars that keep their volume, less the pressure on their sides."""
    s = 1.7
    sides = [s, s**-0.5, s**-0.5]
    x = s**2 + 2.0 / s - 3.0
    bar = lambda law, **c: (lambda P: P[0, 0] - P[1, 1] * sides[1] / s)(
        stretch(law, sides, nu=0.499, **c)
    )
    along = 2.0 * (s - s**-2)
    np.testing.assert_allclose(
        bar("mooney-rivlin", c10=3.0, c01=2.0, mu=10.0), along * (3.0 + 2.0 / s)
    )
    np.testing.assert_allclose(
        bar("yeoh", c10=3.0, c20=-0.1, c30=0.2, mu=6.0),
        along * (3.0 - 0.2 * x + 0.6 * x * x),
    )
    np.testing.assert_allclose(
        bar("gent", mu=6.0, J_m=20.0), along * 3.0 / (1.0 - x / 20.0)
    )
    two = bar("ogden", mu_1=4.0, alpha_1=2.0, mu_2=0.0, alpha_2=3.0, mu=4.0)
    np.testing.assert_allclose(two, 2.0 * along)


@pytest.mark.parametrize("law", ["neo-hookean", "st-venant-kirchhoff", "corotational"])
def test_the_oracles_laws_are_hookes_at_small_strain(law):
    e = 1e-6
    P = stretch(law, [1.0 + e, 1.0, 1.0], E=1.0, nu=0.25)
    np.testing.assert_allclose(np.diag(P), [1.2 * e, 0.4 * e, 0.4 * e], rtol=1e-5)


def test_the_oracles_fibres_keep_to_hookes_law_by_its_constants():
    """A bar along its fibre, and one across it, under tension alone."""
    c = {"E_t": 2.0, "E_l": 8.0, "nu_t": 0.3, "nu_tl": 0.1, "mu_l": 0.7}
    e = 1e-6
    along = stretch("transverse", 1.0 + e * np.array([1, -0.4, -0.4]), phi=0.0, **c)
    np.testing.assert_allclose(along, np.diag([8.0 * e, 0, 0]), rtol=1e-5, atol=1e-11)
    across = stretch(
        "transverse", 1.0 + e * np.array([1, -0.1, -0.3]), phi=np.pi / 2, **c
    )
    np.testing.assert_allclose(across, np.diag([2.0 * e, 0, 0]), rtol=1e-5, atol=1e-11)


@pytest.mark.parametrize("law", ["transverse", "yeoh"])
def test_the_oracles_tangent_is_the_derivative_of_its_forces(law):
    """With mean dilatation, whose pressures and volume ratios follow the nodes."""
    (kind, _) = (k for k in BODIES if (k.law, k.formulation) == (law, MEAN))
    body = draw(np.random.default_rng(1), kind).body
    assembly, random = _oracle.Assembly(body), np.random.default_rng(2)
    u, du = (0.1 * body.points @ random.normal(size=(3, 3)) for _ in "ab")
    du += 1e-3 * random.normal(size=du.shape) * body.points
    ends = [assembly.balance(u + h * du).internal for h in (1e-5, -1e-5)]
    slope = (ends[0] - ends[1]) / 2e-5
    along = assembly.tangent(u) @ du.ravel()
    atol = 1e-7 * np.abs(slope).max()
    np.testing.assert_allclose(along, slope.ravel(), rtol=0, atol=atol)


@pytest.mark.slow  # a program for each kind of element
@pytest.mark.parametrize("kind", BODIES[4::6])
def test_the_oracle_and_the_package_agree_on_forces(kind):
    """Two programs that share no line: only rounding may separate them.

    A flat tet magnifies it by the ratio of its height to its size.
    """
    drawn = draw(np.random.default_rng(1), kind)
    # Quadratic in place, so that quadratic tets hold it and none is inverted.
    X, A = drawn.body.points, 0.1 * np.random.default_rng(2).normal(size=(3, 3))
    u = X @ A + X * X
    theirs = _oracle.Assembly(drawn.body).balance(u)
    ours = np.asarray(internal_force(drawn.model, jnp.asarray(u)))
    scale = np.abs(ours).max()
    np.testing.assert_allclose(theirs.internal, ours, rtol=0, atol=1e-9 * scale)


@pytest.fixture(scope="module")
def solved():
    """A body that is drawn, and its solution, which rounding does not blur."""
    for seed in range(20):
        drawn = draw(np.random.default_rng(seed), BODIES[0])
        solution = solve_equilibrium(drawn.model, drawn.configuration)
        if bool(solution.converged) and float(solution.rounding) < 1e-10:
            return drawn, solution
    raise AssertionError("none of twenty bodies has such an equilibrium")


@pytest.mark.slow
def test_a_solution_is_found_to_be_one(solved):
    assert judge(*solved).violations == []


def test_a_wrong_load_or_support_is_found(solved):
    drawn, solution = solved
    load = drawn.body.load.copy()
    load[drawn.body.free] *= 1.01
    wrong = drawn._replace(body=drawn.body._replace(load=load))
    (text,) = judge(wrong, solution).violations
    assert text.startswith("forces off by ")
    free = drawn.body.free.copy()
    free[-1] = False
    held = drawn._replace(body=drawn.body._replace(free=free))
    assert judge(held, solution).violations == ["a support has moved"]


def test_an_unstable_state_is_found(solved):
    """A body of negative modulus turns every eigenvalue around."""
    drawn, solution = solved
    constants = drawn.body.constants | {"E": -drawn.body.constants["E"]}
    wrong = drawn._replace(body=drawn.body._replace(constants=constants))
    assert any("eigenvalue" in text for text in judge(wrong, solution).violations)


def test_a_state_without_forces_is_found(solved):
    """Beyond its limit a Gent rubber has none, and nan is below every bound."""
    drawn, solution = solved
    E, nu = drawn.body.constants["E"], drawn.body.constants["nu"]
    gent = {"mu": E, "J_m": np.full_like(E, 1e-30), "nu": nu}
    wrong = drawn._replace(body=drawn.body._replace(law="gent", constants=gent))
    (text,) = judge(wrong, solution).violations
    assert "law has no forces" in text


def test_there_are_thirty_kinds_of_bad_input():
    assert len(names()) >= 30


def test_faults_of_an_input():
    good = {"traceback": "", "peak_gb": 1.0, "silent": False}
    assert faults(good) == []
    assert faults({"hangs": True}) == ["hangs"]
    bad = {"traceback": "x", "peak_gb": 5.0, "silent": True}
    assert faults(bad) == ["tracebacks", "over_4_gb", "accepted_silently"]


def python(program):
    return [sys.executable, "-c", program]


def test_a_killed_command_leaves_no_process():
    begin = time.monotonic()
    end = _kills.ended(python("import time; time.sleep(60)"), (0.1, signal.SIGTERM))
    assert (end.code, end.orphans) == (-signal.SIGTERM, 0)
    assert time.monotonic() - begin < 30.0


def test_a_process_that_is_left_counts(monkeypatch):
    monkeypatch.setattr(_kills, "ORPHANS_S", 0.2)
    child = "import time; time.sleep(60)"
    parent = (
        f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', '{child}'])"
    )
    assert _kills.ended(python(parent)).orphans == 1


def test_counts_name_a_part(tmp_path, capsys):
    run = ["run", "reliability", "--output", str(tmp_path), "--count"]
    assert _cli.main([*run, "kill=6"]) == 2
    assert says(capsys.readouterr().err, "reliability ... 'kill' ... It has:")
    with pytest.raises(SystemExit):
        _cli.main([*run, "kills=0"])
    assert says(capsys.readouterr().err, "'kills=0' ... number from 1")
    assert _cli.main(["run", "--all", "--count", "kills=1"]) == 2


def test_only_the_parts_that_are_asked_for_run(monkeypatch, tmp_path):
    from benchmarks._problem import Options

    part = lambda count, say: ({"kills_orphans": count}, ["calibration 3: rows lost"])
    monkeypatch.setattr(reliability, "_PARTS", {"kills": part})
    said = []
    outcome = reliability.run(Options(tmp_path, said.append, {"kills": 2}))
    assert outcome.figures == {"kills_orphans": 2}
    assert not outcome.goals["kills_orphans"].met(2)
    (text,) = said
    assert text.endswith("not hold: calibration 3: rows lost")
