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
    value: Float[Array, "..."], by: Float[Array, ""], name: str | None = None
) -> Float[Array, "..."]:
    """Return a value that has no derivative, lest it be differentiated as a constant.

    Where `by`, a number that is found with it, is differentiated, its tangent is nan,
    and a cotangent that is not zero raises an error that calls it by its `name`.
    Without one it becomes nan: a program with an error in it cannot be kept.
    """
    return value


@without_derivative.defjvp
def _jvp(name, primals, tangents):
    none = _nan.bind(tangents[1], name=name)
    return primals[0], jnp.broadcast_to(none, primals[0].shape)


def _or_nan(tangent, *, name=None):
    still = tangent == 0.0 if name is None else False
    return jnp.where(still, 0.0, jnp.full_like(tangent, jnp.nan))


def _refuse(cotangent, _, *, name):
    if name is None:
        return [_or_nan(cotangent)]
    why = (
        f"{name} has no derivative: it tells how a computation went, or counts. Leave "
        "it out of what is differentiated, or take jax.lax.stop_gradient of it."
    )
    return [refuse_if(jnp.zeros_like(cotangent), cotangent != 0.0, why)]


# Linear, and transposed only where the value counts.
_nan = Primitive("nan")
_nan.def_abstract_eval(lambda t, **_: t)
_nan.def_impl(_or_nan)
mlir.register_lowering(_nan, mlir.lower_fun(_or_nan, False))
ad.deflinear2(_nan, _refuse)
batching.defvectorized(_nan)
# Of a tangent and of a cotangent, nan for what is not zero.
nan_of = partial(_nan.bind, name=None)
