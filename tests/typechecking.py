"""The type checker that jaxtyping puts on every function of the package."""

import functools
from typing import Any

from beartype import BeartypeConf, beartype

# PEP 484's numeric tower: a user may write the gravity (0, 0, -9.81) with integers.
_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))


def typechecked(function):
    """Check the annotations of a function, by code that its first call generates.

    To generate it for all functions takes as long as to import the package. jaxtyping
    asks for two checks: of the arguments, whose result is `Any`, and of the result
    beside the same arguments, which need no second look.
    """
    hints = function.__annotations__
    if hints.get("return", Any) is not Any:
        function.__annotations__ = {"return": hints["return"]}
    checked = functools.cache(lambda: _beartype(function))

    @functools.wraps(function)
    def check(*args, **keywords):
        return checked()(*args, **keywords)

    return check
