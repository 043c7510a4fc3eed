"""Numbers that tell how a computation went, or count, and have no derivative."""

from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from softcal_jax._typing import Array, Bool, Float, is_traced

T = TypeVar("T")


def refuse_if(value: T, wrong: Bool[Array, "..."], why: str) -> T:
    """Return the value; raise a ValueError if `wrong`, or when a program finds it."""
    if not is_traced(wrong) and np.any(wrong):
        raise ValueError(why)
    return eqx.error_if(value, wrong, why)


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def without_derivative(
    value: Float[Array, ""], by: Float[Array, ""], name: str
) -> Float[Array, ""]:
    """Return a value that has no derivative, lest it be differentiated as a constant.

    Where `by`, a number that is found with it, is differentiated, its tangent is nan,
    and a cotangent that is not zero raises an error that calls it by its `name`.
    """
    return value


@without_derivative.defjvp
def _jvp(name, primals, tangents):
    return primals[0], _nan.bind(tangents[1], name=name)


def _refuse(cotangent, _, *, name):
    why = (
        f"{name} has no derivative: it tells how a computation went, or counts. Leave "
        "it out of what is differentiated, or take jax.lax.stop_gradient of it."
    )
    return [refuse_if(jnp.zeros_like(cotangent), cotangent != 0.0, why)]


# Linear, and transposed only where the value counts.
_nan = Primitive("nan")
_nan.def_abstract_eval(lambda t, **_: t)
_nan.def_impl(lambda t, **_: jax.device_put(np.full(np.shape(t), np.nan)))
_lowered = mlir.lower_fun(lambda t, **_: jnp.full_like(t, jnp.nan), False)
mlir.register_lowering(_nan, _lowered)
ad.deflinear2(_nan, _refuse)
batching.defvectorized(_nan)
