"""A calibration as arrays."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._lanes import lane_of
from softcal_jax.calibration._noise import CorrelatedNoise
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
)
from softcal_jax.fields import ParameterSpace, unnamed
from softcal_jax.inference import Whitened, span, whitened_rows

T = TypeVar("T")


class CalibrationProblem(Module):
    """Model, parameters and a batch of configurations that share them.

    Attributes:
        model: The body.
        space: The parameters.
        configurations: One lane per configuration.
        newton: Settings of the equilibrium.
        noise: Covariance of the errors; None where they are independent, with the
            standard deviations of the effectors.
    """

    model: Model
    space: ParameterSpace
    configurations: ConfigurationArrays
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)
    noise: CorrelatedNoise | None = None

    def at(self, z: Float[Array, " n_p"]) -> tuple[Model, ConfigurationArrays]:
        """Return model and configurations with scaled parameters set [-]."""
        model, configurations = self.space.model_at(self.model, z), self.configurations
        if not all(self.space.sets_fields):
            apply = lambda c: self.space.apply(self.model, c, z)[1]
            configurations = jax.vmap(apply)(configurations)
        return model, configurations

    def noise_columns(self) -> Float[Array, "n_e n_columns"]:
        """Return A of the noise in a program, see `CorrelatedNoise` [-]."""
        effectors = self.configurations.effectors
        if self.noise is None:
            return jnp.zeros((effectors.inverse_std.size, 0))
        return jnp.asarray(self.noise.columns(effectors))

    def rows(
        self,
        z: Float[Array, " n_p"],
        delta_e: Float[Array, "n_c n_rows 3"],
        compliance: Float[Array, "n_e n_p"],
    ) -> Whitened:
        """Return errors and their derivatives in units of the noise, priors behind.

        The QP of Eq. (10) is of these rows.

        Args:
            z: Scaled parameters [-].
            delta_e: Simulated minus measured values.
            compliance: W_ep in the units of the effectors.
        """
        weight = jnp.ravel(jnp.asarray(self.configurations.effectors.inverse_std))
        return whitened_rows(
            self.noise_columns(),
            error=weight * jnp.ravel(delta_e),
            W=weight[:, None] * compliance,
            from_prior=jnp.asarray(self.level) * self.space.from_prior(z),
            prior_weights=jnp.asarray(self.level) * self.space.prior_weights(),
        )

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Factor on the stated standard deviations that an error of one stands for [-].

        Errors count in stated units whatever the noise is found to be, so that what is
        added to their squares must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def of_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the first few configurations."""
        of_lanes = self.with_noise(None).of_lanes(slice(n))
        return of_lanes.with_noise(self.noise and self.noise.of_first(n))

    def without_first(self, n: int) -> "CalibrationProblem":
        """Return the calibration to the others, without a noise."""
        return self.with_noise(None).of_lanes(slice(n, None))

    def of_lanes(self, which: slice) -> "CalibrationProblem":
        """Return the calibration to some configurations; it must have no noise."""
        some = lane_of(self.configurations, which)
        return eqx.tree_at(lambda p: p.configurations, self, some)

    def with_noise(self, noise: CorrelatedNoise | None) -> "CalibrationProblem":
        """Return the calibration with another noise."""
        where = lambda p: p.noise
        return eqx.tree_at(where, self, noise, is_leaf=lambda leaf: leaf is None)


def without_names(problem: CalibrationProblem) -> CalibrationProblem:
    """Return the calibration without what would compile other programs.

    These are names, and settings that are no arrays.
    """
    own = unnamed(problem.space), problem.newton.as_arrays()
    return eqx.tree_at(lambda p: (p.space, p.newton), problem, own)


def n_measured(problem: CalibrationProblem) -> int:
    """Return the number of measured coordinates, less those that find mountings."""
    effectors, noise = problem.configurations.effectors, problem.noise
    n = int(np.sum(np.asarray(effectors.inverse_std) > 0.0))
    if noise is None:
        return n
    return n - span(noise.on_host(effectors)[:, noise.n_common :]).shape[1]
