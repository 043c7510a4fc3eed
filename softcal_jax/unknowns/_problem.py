"""What everything is computed from: a robot, what is unknown of it, and its poses."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
    EffectorRecord,
)
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import ParameterSpace, Uncertain, exactly_known
from softcal_jax.inference import Whitened, whitened_rows
from softcal_jax.unknowns._noise import CorrelatedNoise


class ReadingLimits(Module):
    """Limits that a step keeps of some effector coordinates.

    Attributes:
        index: Their places among all coordinates of all poses.
        lower: Smallest values, in their units.
        upper: Largest values.
    """

    index: tuple[int, ...] = eqx.field(static=True, converter=tuple)
    lower: Float[Array | HostArray, " n"]
    upper: Float[Array | HostArray, " n"]

    def of_first(self, n: int) -> "ReadingLimits":
        """Return the limits of the first coordinates."""
        kept = np.flatnonzero(np.array(self.index) < n)
        index = np.array(self.index)[kept].tolist()
        return ReadingLimits(index, self.lower[kept], self.upper[kept])


class Problem(Module):
    """A model, its parameters, and the poses that inform them.

    Programs compute with its arrays alone, see `numbered`: descriptions of the poses,
    records of their effectors and names stand beside these.

    Attributes:
        model: The robot.
        space: Its parameters.
        lanes: The poses as arrays, a lane each, and records of their effectors.
        poses: The poses as described; those that are fitted come first.
        n_held_out: How many of them are not fitted.
        uncertain: How well everything that is no parameter is known.
        newton: Settings of the equilibria.
        noise: Noise of what was measured; without it the errors are independent, with
            the standard deviations of the effectors.
        deviations: With these each pose is of a specimen of its own, whose scaled
            parameters are z plus its row [-].
        limits: Limits of readings that steps keep, beside those of the parameters.
    """

    model: Model
    space: ParameterSpace
    lanes: ConfigurationLanes
    poses: tuple[Configuration, ...] = eqx.field(converter=tuple)
    n_held_out: int = eqx.field(static=True, default=0)
    uncertain: Uncertain = eqx.field(default_factory=exactly_known)
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)
    noise: CorrelatedNoise | None = None
    deviations: Float[Array, "n_c n_p"] | None = None
    limits: ReadingLimits | None = None

    def __check_init__(self):
        if self.deviations is None:
            return
        shape = len(self.configurations.gravity), len(self.space.names)
        if self.deviations.shape != shape or self.n_held_out:
            raise ValueError(
                "deviations must have a row for each configuration and a column for "
                f"each parameter, {shape}, and none may be held out; got shape "
                f"{self.deviations.shape}, and {self.n_held_out} held out."
            )

    @property
    def configurations(self) -> ConfigurationArrays:
        """The poses as arrays, a lane each."""
        return self.lanes.arrays

    @property
    def records(self) -> tuple[tuple[EffectorRecord, ...], ...]:
        """Records of the effectors of each pose."""
        return self.lanes.effectors

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the poses."""
        return tuple(pose.name for pose in self.poses)

    @property
    def n_fitted(self) -> int:
        """Number of poses that are fitted."""
        return len(self.configurations.gravity) - self.n_held_out

    @property
    def fitted(self) -> "Problem":
        """The same with the poses that are fitted alone."""
        return self.of_first(self.n_fitted) if self.n_held_out else self

    def at(self, z: Float[Array, " n_p"]) -> tuple[Model, ConfigurationArrays]:
        """Return model and configurations with scaled parameters set [-]."""
        model, configurations = self.space.model_at(self.model, z), self.configurations
        if not all(self.space.sets_fields):
            apply = lambda c: self.space.apply(self.model, c, z)[1]
            configurations = jax.vmap(apply)(configurations)
        return model, configurations

    def rows(
        self,
        z: Float[Array, " n_p"],
        delta_e: Float[Array, "n_c n_rows 3"],
        compliance: Float[Array, "n_e n_p"],
        marginalised: Float[Array, "n_e k"] | None = None,
    ) -> Whitened:
        """Return whitened errors and their derivatives, then those of the priors.

        The QP of Eq. (10) minimises these rows; the compliance is W_ep. Differences of
        neighbours, where they count, stand before the priors. What is `marginalised`
        beside the noise has columns like those of the noise.
        """
        effectors = self.configurations.effectors
        weight = jnp.ravel(jnp.asarray(effectors.inverse_std))
        columns = jnp.zeros((weight.size, 0))
        if self.noise is not None:
            columns = jnp.asarray(self.noise.columns(effectors))
        if marginalised is not None:
            columns = jnp.concatenate([columns, marginalised], axis=1)
        distances = self.space.from_prior(z)
        prior = jnp.diag(self.space.prior_weights())
        if self.space.likeness is not None:
            differences, A = self.space.likeness.rows(z)
            distances = jnp.concatenate([differences, distances])
            prior = jnp.concatenate([A, prior])
        return whitened_rows(
            columns,
            error=weight * jnp.ravel(delta_e),
            W=weight[:, None] * compliance,
            from_prior=jnp.asarray(self.level) * distances,
            prior_rows=jnp.asarray(self.level) * prior,
        )

    def excess(
        self,
        effectors: Float[Array, "n_c n_rows 3"],
        compliance: Float[Array, "n_e n_p"],
    ) -> Whitened | None:
        """Return how far readings exceed their limits, and the derivatives of that.

        First those below the smallest values, then those above the largest; negative
        within the limits, and in units of the readings.
        """
        if self.limits is None:
            return None
        where = np.array(self.limits.index)
        values, W = jnp.ravel(effectors)[where], compliance[where]
        beyond = self.limits.lower - values, values - self.limits.upper
        return Whitened(jnp.concatenate(beyond), jnp.concatenate([-W, W]))

    @property
    def level(self) -> Float[Array | HostArray, ""] | float:
        """Standard deviation of the errors in `rows`, over the stated one [-].

        Rows that are added to these errors must be multiplied by it.
        """
        return 1.0 if self.noise is None else self.noise.jitter

    def of_first(self, n: int) -> "Problem":
        """Return the problem of the first few poses, all of them fitted."""
        some = lane_of(self.configurations, slice(n))
        return replace(
            self,
            lanes=ConfigurationLanes(some, self.records[:n]),
            poses=self.poses[:n],
            n_held_out=0,
            noise=self.noise and self.noise.of_first(n),
            deviations=None if self.deviations is None else self.deviations[:n],
            limits=self.limits and self.limits.of_first(some.effectors.measured.size),
        )

    def with_noise(self, noise: CorrelatedNoise | None) -> "Problem":
        """Return the problem with another noise."""
        return replace(self, noise=noise)

    @property
    def bare(self) -> "Problem":
        """The arrays alone, without what describes the poses."""
        return replace(
            self,
            lanes=ConfigurationLanes(self.configurations, ()),
            poses=(),
            n_held_out=0,
            uncertain=_NOTHING,
        )

    @property
    def numbered(self) -> "Problem":
        """The arrays alone, without names and settings that would compile programs."""
        space, newton = self.space.numbered, self.newton.as_arrays()
        return replace(self.bare, space=space, newton=newton)


_NOTHING = exactly_known()
