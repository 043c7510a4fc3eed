"""Properties of immutable modules that are computed once."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

import jax

from softcal_jax._typing import is_traced

Value = TypeVar("Value")


class once(Generic[Value]):
    """Property whose first value is kept, for what loops on the host ask for often.

    The outer loop asks for parameters and bounds at every step. Unlike with
    `functools.cached_property`, a traced value is not kept: it is of no use outside
    its trace.
    """

    def __init__(self, compute: Callable[[Any], Value]):
        """Wrap a method that takes no argument."""
        self.compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        """Note the name under which the value is kept."""
        self.name = name

    @overload
    def __get__(self, module: None, owner: type) -> "once[Value]": ...

    @overload
    def __get__(self, module: Any, owner: type) -> Value: ...

    def __get__(self, module: Any, owner: type) -> Any:
        """Compute the value; afterwards the kept one stands before this."""
        if module is None:
            return self
        value = self.compute(module)
        if not any(map(is_traced, jax.tree.leaves(value))):
            # Beside the fields, so neither a leaf nor part of a changed copy.
            module.__dict__[self.name] = value
        return value
