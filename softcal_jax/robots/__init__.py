"""Ready-made robots, with the data they were measured with."""

from softcal_jax.robots._silicone_beam import silicone_beam_path

__all__ = ["silicone_beam_path"]
