"""Strict numerics for every test: float64, no promotion, checked annotations."""

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Here, because it must come before the first import of the package.
install_import_hook("softcal_jax", "typechecking.typechecked")
