"""The type checker that jaxtyping puts on every function of the package."""

from beartype import BeartypeConf, beartype

# PEP 484's numeric tower: a user may write the gravity (0, 0, -9.81) with integers.
typechecked = beartype(conf=BeartypeConf(is_pep484_tower=True))
