"""Ready-made robots, with the data they are calibrated to."""

from softcal_jax.robots._ready_made import (
    READY_MADE as READY_MADE,
    AnisotropicBeam as AnisotropicBeam,
    anisotropic_beam as anisotropic_beam,
    ready_made_path as ready_made_path,
    simulated_measurements as simulated_measurements,
    synthetic_measurements as synthetic_measurements,
)
