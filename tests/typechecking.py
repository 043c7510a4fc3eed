"""The check of annotations that tests put on every function of the package."""

import dataclasses
import functools
import inspect
from collections import Counter
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKED = 30
"""Calls of a function in a process whose arguments and results are checked.

A check takes longer than many functions do; checks of all calls, a fifth of all tests.
"""

# PEP 484's numeric tower: a user may write the gravity (0, 0, -9.81) with integers.
_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))

_CALLS: Counter[Any] = Counter()
"""Calls so far, by code: what a function defines is defined anew at each call."""

_jaxtyped = jaxtyping.jaxtyped


def install() -> None:
    """Check the annotations of what is imported of the package from now on."""
    jaxtyping.jaxtyped = jaxtyped
    jaxtyping.install_import_hook("softcal_jax", "typechecking.typechecked")


def jaxtyped(what=None, *, typechecker):
    """Check the first calls as `jaxtyping.jaxtyped` does, which decorates all."""
    again = functools.partial(jaxtyped, typechecker=typechecker)
    if what is None:
        return again
    if isinstance(what, property):
        return property(*(f and again(f) for f in (what.fget, what.fset, what.fdel)))
    if isinstance(what, classmethod | staticmethod):
        return type(what)(again(what.__func__))
    if inspect.isclass(what):
        if dataclasses.is_dataclass(what) and "__init__" in vars(what):
            what.__init__ = again(what.__init__)
        return what
    code = getattr(what, "__code__", None)
    if code is None:
        return _jaxtyped(what, typechecker=typechecker)
    if _CALLS[code] >= CHECKED:
        return what
    checked = functools.cache(lambda: _jaxtyped(what, typechecker=typechecker))

    @functools.wraps(what)
    def check(*args, **keywords):
        if _CALLS[code] >= CHECKED:
            return what(*args, **keywords)
        _CALLS[code] += 1
        return checked()(*args, **keywords)

    return check


def typechecked(function):
    """Check the annotations of a function.

    jaxtyping asks for two checks: of the arguments, whose result is `Any`, and of the
    result beside the same arguments, which need no second look.
    """
    hints = function.__annotations__
    if hints.get("return", Any) is not Any:
        function.__annotations__ = {"return": hints["return"]}
    return _beartype(function)
