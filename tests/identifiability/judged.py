"""Compliances made by hand, of moduli and angles, and the verdict on them."""

from dataclasses import replace

import numpy as np

from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import identifiability
from softcal_jax.inference import ErrorColumns, independent


def modulus(name="E", start=1e5, ratio=100.0):
    """A modulus whose bounds are a ratio apart, with the start in their middle."""
    half = np.sqrt(ratio)
    return Parameter(name, name, start, start / half, start * half, unit="Pa")


def angle(name="theta", half_width=np.pi / 2, S=None):
    return Parameter(
        name, name, 0.3, -half_width, half_width, scale="linear", S=S, unit="rad"
    )


def judge(W, *parameters, W_c=None, noise_scale=1.0, **keywords):
    """The verdict on noise-weighted compliances, with the priors of the parameters."""
    space = ParameterSpace(parameters)
    linear = replace(
        independent(np.array(W, float), tuple(space.names), scale=noise_scale),
        prior_weights=np.asarray(space.prior_weights()),
    )
    if W_c is not None:
        labels = ("loads",) * W_c.shape[1]
        linear = replace(linear, considered=ErrorColumns(W_c, labels, labels))
    return identifiability(linear, space, space.start(), **keywords)
