"""Results put together by hand: every number in them is known."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    ConfigurationResult,
    HistoryEntry,
    ParameterEstimate,
    simulation_result,
)
from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    NewtonSettings,
    build_model,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import Gain, Ranking
from softcal_jax.inference import Cause, ErrorBudget, Uncertainty, independent
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Fibre,
    Isotropic,
    NeoHookean,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import beam

AT_REST = np.array([[0.1, 0.02, 0.02], [0.1, 0.0, 0.02]])
"""Two markers at the end of the beam [m]."""


def small_model(order=1):
    """A beam of 10 cm, neo-Hookean, with another modulus in every tet."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1), order=order)
    E = jnp.linspace(1e5, 3e5, mesh.n_tets)
    return build_model(mesh, NeoHookean(E, 0.4), density=1000.0)


def sag(mesh, tip=0.02):
    """A displacement that bends the beam downwards by `tip` [m]."""
    s = mesh.points[:, 0] / 0.1
    return np.stack([-0.2 * tip * s**2, 0.0 * s, -tip * s**2], axis=1)


def make_fit(
    mesh, name="droop", role="calibration", error=(0.001, 0.0, 0.0), axes="xyz", y=0.0
):
    """Markers move down by 20 mm; simulated ones miss by `error`, 4 times as before.

    On what is not among the `axes` nothing was measured, and y holds another number.
    """
    true = AT_REST - np.array([0.0, 0.0, 0.02])
    measured = true + np.array([0.0, y, 0.0])
    markers = Markers(("left", "right"), AT_REST, axes=axes)
    posed = Configuration(name, "x_min", markers=markers, measured=measured)
    (records,) = configuration_lanes(mesh, [posed]).effectors
    effectors = tuple(
        dataclasses.replace(
            record, simulated_before=row + 4.0 * np.array(error), simulated=row + error
        )
        for record, row in zip(records, true, strict=True)
    )
    return ConfigurationResult(
        name=name,
        role=role,
        converged=True,
        outcome="converged",
        effectors=effectors,
        displacement=sag(mesh),
        newton_steps=5,
        load_steps=1,
        residual=1e-9,
        rounding=1e-12,
        at_rounding=False,
        min_det_F=0.9,
    )


def with_points(fit, **changed):
    """The fit with other values of its markers, by functions of each."""
    points = (
        dataclasses.replace(p, **{key: value(p) for key, value in changed.items()})
        for p in fit.points
    )
    return dataclasses.replace(fit, effectors=(*points, *fit.others))


def nowhere_before(fit):
    """The fit of a pose that has no equilibrium with the start parameters."""
    return with_points(fit, simulated_before=lambda p: np.full_like(p.measured, np.nan))


def make_history(rejected=()):
    """Four steps on E and nu, the last below the tolerance."""
    sizes = [np.inf, 0.3, 0.1, 1e-3, 1e-8]
    return tuple(
        HistoryEntry(
            step=k,
            cost=10.0 / (k + 1),
            rms=0.004 / (k + 1),
            lambda_p=(-size, 0.5 * size),
            step_bound=1.0,
            accepted=k not in rejected,
            kkt_residual=0.0,
            newton_steps=(4, 5),
            values={"E": 2e5 + 1e4 * k, "nu": 0.4 + 0.01 * k},
            noise_level=1.0,
            seconds=0.1 * k,
        )
        for k, size in enumerate(sizes)
    )


def make_budget(parameters):
    """Four fifths of each standard error are noise, three fifths the clamp."""
    errors = np.array([q.standard_error for q in parameters])
    return ErrorBudget(
        names=tuple(q.name for q in parameters),
        values=np.array([q.value for q in parameters]),
        slopes=np.ones(len(errors)),
        units=tuple(q.unit for q in parameters),
        noise=np.diag((0.8 * errors) ** 2),
        causes=(Cause("clamp", ("clamp",), 0.6 * errors[:, None]),),
    )


def make_result(*, converged=True, fits=None, rejected=(), model=None, **changed):
    """A calibration of E (kept) and nu (ended on its bound, so without an error)."""
    model = model or small_model()
    if fits is None:
        fits = (
            make_fit(model.mesh),
            make_fit(model.mesh, "held out", "validation", (0.0, 0.002, 0.0)),
        )
    covariance = np.full((2, 2), np.nan)
    covariance[0, 0] = 4e-4
    fields = {
        "parameters": (
            ParameterEstimate("E", 2.4e5, 6e3, 2e5, 1e5, 1e6, "Pa", False),
            ParameterEstimate("nu", 0.44, np.nan, 0.4, 0.3, 0.44, "", True),
        ),
        "uncertainty": Uncertainty(
            covariance, "estimated", 1.5, 10, 22.5, np.array([False, True])
        ),
        "history": make_history(rejected),
        "space": modulus_and_ratio(),
        "z": modulus_and_ratio().to_scaled(jnp.array([2.4e5, 0.44])),
        # Half of the coordinates see E, half see nu, all well.
        "linear": independent(
            np.tile(np.array([[100.0, 0.0], [0.0, 100.0]]), (6, 1)),
            ("E", "nu"),
            scale=1.5,
        ),
        "notes": ("nu ended on a bound.",),
    }
    fields |= changed
    of = {interval.name: interval for interval in fields.pop("intervals", ())}
    fields["parameters"] = tuple(
        dataclasses.replace(q, interval=of.get(q.name)) for q in fields["parameters"]
    )
    fields.setdefault("budget", make_budget(fields["parameters"]))
    return CalibrationResult(
        converged=converged,
        configurations=tuple(fits),
        model=model,
        settings=CalibrationSettings(),
        newton=NewtonSettings(),
        timing_s={"steps": 1.5},
        **fields,
    )


class Pair(AbstractLaw):
    """A law with two fields of one name."""

    first: Isotropic
    second: Isotropic

    def energy_density(self, F):
        strain = 0.5 * (F + F.T) - jnp.eye(3)
        stress = self.first.stress(strain) + self.second.stress(strain)
        return 0.5 * jnp.sum(strain * stress)


def two_elasticities():
    """A beam of such a law."""
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    law = Pair(Isotropic(1e5, 0.3), Isotropic(2e5, 0.3))
    return build_model(mesh, law, density=1000.0)


def modulus_and_ratio():
    """The space of E and nu."""
    return ParameterSpace(
        (
            Parameter("E", "E", 2e5, 1e5, 1e6, unit="Pa"),
            Parameter("nu", "nu", 0.4, 0.3, 0.44, scale="linear"),
        )
    )


def axis_model():
    """A beam whose law has the constants of `axis_space`."""
    law = Corotational(ReducedTransverseIsotropic(5e5, 2e5, 0.3, Fibre(0.35)))
    return build_model(small_model().mesh, law, density=1000.0)


def axis_space():
    """A modulus and an angle: 500 kPa between 100 and 1000, 20 degrees of 180."""
    return ParameterSpace(
        (
            Parameter("E_t", "E_t", 5e5, 1e5, 1e6, unit="Pa"),
            Parameter(
                "theta",
                "theta",
                np.deg2rad(20.0),
                -np.pi / 2,
                np.pi / 2,
                scale="linear",
                unit="rad",
            ),
        )
    )


def make_ranking():
    """One candidate that shows the angle, and one without an equilibrium."""
    errors = np.array([0.5, 0.1])
    gain = Gain("turned", errors, "theta", 0.9, 0.01, 0.35, "rad")
    unranked = {"crushed": "inverted"}
    return Ranking((gain,), unranked, "Fewest that reach 10 %: turned.", True)


def make_simulation(model, outcomes=(True, False)):
    """Configurations and their equilibria; where False, the tets are inverted."""
    configurations = [
        Configuration(
            f"lane {i}",
            [Support("x_min")],
            markers=Markers(("left", "right"), AT_REST) if i == 0 else None,
        )
        for i in range(len(outcomes))
    ]
    n = len(outcomes)
    result = jax.vmap(
        lambda ok: RESULTS.where(ok, RESULTS.converged, RESULTS.inverted)
    )(jnp.array(outcomes))
    solution = EquilibriumSolution(
        displacement=jnp.stack([jnp.asarray(sag(model.mesh))] * n),
        multipliers=jnp.zeros((n, 0)),
        result=result,
        steps=jnp.arange(4, 4 + n),
        load_steps=jnp.ones(n, int),
        load_reached=jnp.where(jnp.array(outcomes), 1.0, 0.0),
        residual=jnp.full(n, 1e-9),
        rounding=jnp.full(n, 1e-12),
        at_rounding=jnp.zeros(n, bool),
        min_det_F=jnp.where(jnp.array(outcomes), 0.9, -0.1),
        n_negative=jnp.zeros(n, int),
        approached=jnp.full(n, jnp.nan),
        along_path=jnp.full(n, jnp.nan),
        contacts=jnp.zeros((n, 0, 5)),
        touched=(),
    )
    return configurations, solution


def make_simulation_result(model, outcomes=(True, False)):
    """The result of such a simulation."""
    return simulation_result(model, *make_simulation(model, outcomes))


def replaced(result, **changed):
    """The result with other values of some fields."""
    return eqx.tree_at(
        lambda r: [getattr(r, name) for name in changed],
        result,
        list(changed.values()),
        is_leaf=lambda leaf: leaf is None,
    )
