"""Compliances made by hand, of moduli and angles, and the verdict on them."""

import numpy as np

from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import identifiability


def modulus(name="E", start=1e5, ratio=100.0):
    """A modulus whose bounds are a ratio apart, with the start in their middle."""
    half = np.sqrt(ratio)
    return Parameter(name, name, start, start / half, start * half, unit="Pa")


def angle(name="theta", half_width=np.pi / 2, S=None):
    return Parameter(
        name, name, 0.3, -half_width, half_width, scale="linear", S=S, unit="rad"
    )


def judge(W, *parameters, **keywords):
    space = ParameterSpace(parameters)
    return identifiability(np.array(W, float), space, space.start(), **keywords)
