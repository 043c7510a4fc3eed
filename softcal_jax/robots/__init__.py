"""Ready-made robots, with the data they were measured with."""

from softcal_jax.robots._anisotropic_beam import AnisotropicBeam, anisotropic_beam
from softcal_jax.robots._silicone_beam import silicone_beam_path

__all__ = ["AnisotropicBeam", "anisotropic_beam", "silicone_beam_path"]
