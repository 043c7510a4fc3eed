"""A calibration as arrays."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._noise import CorrelatedNoise, whitened
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
)
from softcal_jax.fields import ParameterSpace, unnamed

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

    def in_noise_units(self, x: Float[Array, "n_e ..."]) -> Float[Array, "n_e ..."]:
        """Convert stacked values from the units of the effectors to those of the noise.

        They are divided by the standard deviations and made independent, see
        `CorrelatedNoise` [-].
        """
        effectors = self.configurations.effectors
        weight = jnp.asarray(effectors.inverse_std)
        x = weight.reshape(-1, *(1,) * (x.ndim - 1)) * x
        if self.noise is None:
            return x
        return whitened(jnp.asarray(self.noise.columns(effectors)), x)

    def on_host_in_noise_units(
        self, x: Float[HostArray, "n_e ..."]
    ) -> Float[HostArray, "n_e ..."]:
        """Convert as `in_noise_units`, without a compiled program for each shape."""
        weight = np.asarray(self.configurations.effectors.inverse_std)
        return whitened(
            self.noise_columns(), weight.reshape(-1, *(1,) * (x.ndim - 1)) * x
        )

    def noise_columns(self) -> Float[HostArray, "n_e n_columns"]:
        """Return A of the noise on the host, see `CorrelatedNoise` [-]."""
        effectors = jax.tree.map(np.asarray, self.configurations.effectors)
        if self.noise is None:
            return np.zeros((effectors.inverse_std.size, 0))
        return np.asarray(jax.tree.map(np.asarray, self.noise).columns(effectors))

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Factor on the stated standard deviations that an error of one stands for [-].

        Errors count in stated units whatever the noise is found to be, so that what is
        added to their squares must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def prior_weights(self) -> Float[Array, " n_p"]:
        """Return 1 / standard deviations of the prior, in units of the errors [-]."""
        return jnp.asarray(self.level) * self.space.prior_weights()

    def from_prior(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Return distances from the prior, in units of the errors [-]."""
        return jnp.asarray(self.level) * self.space.from_prior(z)

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
    """Return the number of measured coordinates, less those that find offsets."""
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    spent = 0 if problem.noise is None else problem.noise.n_attachment_offsets(weight)
    return int(np.sum(weight > 0.0)) - spent
