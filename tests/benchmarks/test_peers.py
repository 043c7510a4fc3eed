"""The job that the peers share, and what is said of those that are not installed."""

import sys
import time
from importlib import import_module

import jax
import numpy as np
import pytest
from wording import says

from benchmarks import _peer_law, _peer_process, peers
from benchmarks._paper import STD
from benchmarks._peer import (
    AbstractAdjointPeer,
    AbstractPeer,
    NoEquilibrium,
    Response,
    peer_gradient,
)
from benchmarks._peer_calibration import Residuals, calibrate_by
from benchmarks._peer_job import our_gradient, our_static, peer_job
from benchmarks._problem import Options
from softcal_jax.materials import Fibre, ReducedTransverseIsotropic, StVenantKirchhoff


@pytest.fixture(scope="module")
def job():
    return peer_job((2, 1, 1))


def influence(job):
    """Moves of the nodes in proportion to the fields, in place of any elements [m]."""
    fields = job.fields(job.start)
    random = np.random.default_rng(0)
    size = (len(job.points), 3, *fields.shape)
    return 1e-3 * random.standard_normal(size) / np.abs(fields + 1.0) / len(fields)


class Differenced(AbstractPeer):
    def __init__(self, job):
        super().__init__(job, "without adjoint")
        self.influence = influence(job)
        self.guesses = []
        self.fails = False

    def solve(self, pose, fields, guess=None):
        self.guesses.append(guess)
        if self.fails:
            raise NoEquilibrium("as asked for")
        return np.einsum("naTf,Tf->na", self.influence, fields)


class Adjoint(AbstractAdjointPeer):
    def __init__(self, job):
        super().__init__(job, "with adjoint")
        self.influence = influence(job)

    def solve(self, pose, fields, guess=None):
        return np.einsum("naTf,Tf->na", self.influence, fields)

    def response(self, pose, fields, guess=None):
        of_marker = self.influence[self.job.poses[pose].marker]
        pull = lambda covector: np.einsum("a,aTf->Tf", covector, of_marker)
        return Response(self.solve(pose, fields), pull)


@pytest.mark.slow  # programs of a peer's job that no other test needs
def test_rows_of_the_fields_are_their_derivative(job):
    z, h = job.start, 1e-5
    for i, unit in enumerate(np.eye(len(z))):
        change = (job.fields(z + h * unit) - job.fields(z - h * unit)) / (2.0 * h)
        rows = job.field_rows(z)[:, :, i]
        # Second order: 1e-10 of the third derivative, and rounding of 1e-11 of a value.
        np.testing.assert_allclose(change, rows, rtol=1e-8, atol=1e-8 * rows.max())


def test_the_fields_are_those_of_the_law(job):
    """At the start both control points have the same values."""
    fields = job.fields(job.start)
    assert fields.shape == (len(job.tets), 3)
    np.testing.assert_allclose(fields, [[700e3, 400e3, 0.0]] * len(fields), atol=1e-9)


def test_poses_are_plain_arrays(job):
    for pose, free in zip(job.poses, [0.150, 0.150, 0.150, 0.0], strict=True):
        np.testing.assert_allclose(job.points[pose.held, 0], 0.150 - free, atol=1e-12)
        np.testing.assert_allclose(job.points[pose.marker, 0], free, atol=1e-12)
        assert np.linalg.norm(pose.gravity) == pytest.approx(9.81)
        assert 1e-3 < np.linalg.norm(pose.measured) < 0.1
    u = np.asarray(our_static(job, 3, job.target).displacement)
    pose = job.poses[3]
    # Measured along another way; both are left at 1e-8 of the largest force.
    atol = 1e-8 * np.linalg.norm(pose.measured)
    np.testing.assert_allclose(u[pose.marker], pose.measured, rtol=0.0, atol=atol)


@pytest.mark.slow  # programs of a peer's job that no other test needs
def test_our_gradient_is_that_of_the_error(job):
    z, h, pose = job.start, 1e-4, job.poses[1]

    def error(z):
        u = np.asarray(our_static(job, 1, z).displacement)[pose.marker]
        return 0.5 * np.sum((u - pose.measured) ** 2) / STD**2

    gradient = our_gradient(job, 1, z)
    np.testing.assert_allclose(gradient.value, error(z), rtol=1e-7)
    steps = h * np.eye(len(z))
    change = [(error(z + step) - error(z - step)) / (2.0 * h) for step in steps]
    size = np.abs(gradient.by_parameter).max()
    np.testing.assert_allclose(gradient.by_parameter, change, rtol=0, atol=1e-5 * size)


def test_the_law_of_the_peers_is_ours():
    """Stress and tangent at random states, of two tets with three points each."""
    random = np.random.default_rng(1)
    fields = np.array([[9e5, 3e5, 0.35], [6e5, 6.5e5, -0.9]])
    F = np.eye(3)[:, :, None, None] + 0.2 * random.standard_normal((3, 3, 3, 2))
    C = _peer_law.stiffness(fields, 0.3)

    @jax.jit
    def ours(field, F):
        E_t, E_l, theta = field
        fibre = Fibre(theta, plane="xy")
        law = StVenantKirchhoff(ReducedTransverseIsotropic(E_t, E_l, 0.3, fibre))
        return jax.grad(law.energy_density)(F), jax.jacfwd(law.stress)(F)

    P, A = _peer_law.stress(F, C), _peer_law.tangent(F, C)
    for tet, field in enumerate(fields):
        for point in range(3):
            of_energy, of_stress = ours(field, F[:, :, point, tet])
            np.testing.assert_allclose(P[:, :, point, tet], of_energy, rtol=1e-9)
            # Some entries are differences of moduli.
            tangent = A[..., point, tet]
            np.testing.assert_allclose(tangent, of_stress, rtol=1e-9, atol=1e-9 * 9e5)


def test_adjoint_and_differences_give_one_gradient(job):
    by_adjoint = peer_gradient(Adjoint(job), 2, job.start, STD)
    by_differences = peer_gradient(Differenced(job), 2, job.start, STD)
    np.testing.assert_allclose(by_adjoint.value, by_differences.value, rtol=1e-12)
    size = np.abs(by_adjoint.by_parameter).max()
    # Forward differences are off by the step times the second derivative.
    np.testing.assert_allclose(
        by_adjoint.by_parameter, by_differences.by_parameter, rtol=0, atol=1e-4 * size
    )


def test_residuals_and_their_jacobian(job):
    by_adjoint = Residuals(Adjoint(job), by_adjoint=True)
    by_differences = Residuals(Differenced(job), by_adjoint=False)
    z = job.start
    assert by_adjoint(z).shape == (12,)
    np.testing.assert_allclose(by_adjoint(z), by_differences(z), rtol=1e-12)
    rows, change = by_adjoint.jacobian(z), by_differences.jacobian(z)
    np.testing.assert_allclose(rows, change, rtol=0, atol=1e-4 * np.abs(rows).max())


def test_equilibria_start_from_the_last_ones(job):
    peer = Differenced(job)
    residuals = Residuals(peer, by_adjoint=False)
    residuals(job.start)
    assert peer.guesses == [None] * 4
    residuals(job.start)
    assert all(guess is not None for guess in peer.guesses[4:])


def test_a_pose_without_equilibrium_is_very_bad(job):
    peer = Differenced(job)
    residuals = Residuals(peer, by_adjoint=False)
    residuals(job.start)
    peer.fails = True
    np.testing.assert_array_equal(residuals(job.start), 1e6)
    # Each pose from the guess, and then from rest.
    assert [guess is None for guess in peer.guesses[4:]] == [False, True] * 4


def test_a_run_out_of_time_counts_as_its_limit(job):
    end = calibrate_by(Adjoint(job), by_adjoint=True, limit_s=0.0)
    assert end == (0.0, 0, False)


@pytest.mark.slow
def test_a_peer_that_solves_another_problem_is_refused(job):
    ours, gradient = peers.our_slope(job), peers.by_parameter(Adjoint(job))
    with pytest.raises(RuntimeError, match=r"other .*tip by"):
        peers.agreement(job, "other", peers.tips(Adjoint(job)), ours)
    moved = np.stack([pose.measured for pose in job.poses])
    with pytest.raises(RuntimeError, match=r"(?s)gradient .*same problem"):
        peers.agreement(job, "other", moved, gradient)
    agreement = peers.agreement(job, "same", moved, ours)
    assert agreement == {
        "tip_difference": pytest.approx(0.0, abs=1e-8),  # that of the equilibria
        "gradient_difference": 0.0,
    }


class Slow(Adjoint):
    def solve(self, pose, fields, guess=None):
        time.sleep(0.02)
        return super().solve(pose, fields, guess)


def test_the_quickest_way_is_taken(job):
    ways = [lambda: Slow(job), lambda: Adjoint(job)]
    assert type(_peer_process.quickest(ways, job)) is Adjoint


class Unopened(_peer_process.PeerProcess):
    """Opens what `installed` says, without a process."""

    installed = ("_peer_here",)

    def open(self, module):
        if module in self.installed:
            return "with adjoint"
        raise ModuleNotFoundError("No module named 'torch'", name="torch")


LIBRARIES = {
    "here": peers.Library("_peer_here", (), "benchmarks"),
    "gone": peers.Library("_peer_gone", (), "peers"),
}


def test_an_absent_peer_is_reported():
    with peers.opened(LIBRARIES, Unopened) as (present, absent):
        assert [peer.label for peer in present.values()] == ["with adjoint"]
        assert list(absent) == ["gone"]
        assert says(absent["gone"], "torch ... softcal-jax[peers]")


@pytest.mark.parametrize(
    ("name", "missing", "extra"),
    [("felupe", "felupe", "benchmarks"), ("torch_fem", "torch", "peers")],
)
def test_a_library_that_is_missing_names_itself(job, monkeypatch, name, missing, extra):
    monkeypatch.setitem(sys.modules, missing, None)
    for module in ("_felupe", "_peer_felupe"):
        monkeypatch.delitem(sys.modules, f"benchmarks.{module}", raising=False)
    library = peers.LIBRARIES[name]
    with pytest.raises(ModuleNotFoundError) as error:
        import_module(f"benchmarks.{library.module}").variants(job)
    assert (error.value.name, library.extra) == (missing, extra)


@pytest.mark.slow  # a process that sets up the whole beam
def test_a_module_of_ours_that_is_missing_is_not_hidden():
    """In a process of its own, which hands on what it raises."""
    nowhere = {"nowhere": peers.Library("_peer_nowhere", (), "peers")}
    with (
        pytest.raises(ModuleNotFoundError, match="_peer_nowhere"),
        peers.opened(nowhere),
    ):
        pass


def test_a_run_without_peers_tells_ours(job, monkeypatch, tmp_path):
    monkeypatch.setattr(peers, "peer_job", lambda: job)
    monkeypatch.setattr(peers, "our_end", lambda job: {"ours_recovered": 1})
    monkeypatch.setattr(peers, "our_calibration", lambda job: None)
    absent = lambda libraries: opened({"gone": LIBRARIES["gone"]}, Unopened)
    opened = peers.opened
    monkeypatch.setattr(peers, "opened", absent)
    outcome = peers.run(Options(tmp_path, say=lambda _: None))
    assert set(outcome.figures) == {
        "ours_recovered",
        "ours_static_ms",
        "ours_gradient_ms",
        "ours_calibration_s",
    }
    assert outcome.goals == {}
    name, absence = outcome.tables[0].rows[1][:2]
    assert name == "gone"
    assert says(absence, "torch ... softcal-jax[peers]")


def test_ratios_are_peers_over_ours():
    figures = peers.times(
        {
            "static": {"ours": [0.1, 0.2, 0.9], "a": [0.4, 0.4, 3.0]},
            "calibration": {"ours": [2.0], "a": [120.0]},
        }
    )
    assert figures == {
        "ours_static_ms": pytest.approx(200.0),
        "a_static_ms": pytest.approx(400.0),
        "a_static": pytest.approx(2.0),
        "ours_calibration_s": 2.0,
        "a_calibration_s": 120.0,
        "a_calibration": 60.0,
    }
