"""Properties of immutable modules that are computed once."""

from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import jax

from softcal_jax._typing import is_traced

Value = TypeVar("Value")


class once(cached_property[Value]):
    """Property whose first value is kept, for what loops on the host ask for often.

    The outer loop asks for parameters and bounds at every step. Unlike that of its
    base, a traced value is not kept: it is of no use outside its trace.
    """

    if not TYPE_CHECKING:  # its type is that of the base

        def __get__(self, module: Any, owner: Any = None) -> Any:
            """Compute the value, or return the kept one."""
            value = super().__get__(module, owner)
            if module is not None and any(map(is_traced, jax.tree.leaves(value))):
                del vars(module)[self.attrname]
            return value
