"""The published homogenisation of a printed foam."""

import numpy as np

from softcal_jax.materials._foam import FoamTable

TPU = 12e6
"""Young's modulus of the printed solid of the published tables [Pa]."""

# F. Vanneste et al., "Anisotropic soft robots based on 3D printed meso-structured
# materials", IEEE RA-L 5 (2020), as in the authors' published scenes: the relative
# density, and Ex, Ey and Ez over E of the solid, with x the soft axis. For the
# isotropic foam the relative density and the mean modulus over E of the solid.
_STRETCHED = np.array(
    [
        (0.0918, 0.00719095, 0.0677105, 0.0618133),
        (0.1798, 0.00823011, 0.1462979, 0.1372145),
        (0.2639, 0.00943911, 0.2214149, 0.2104164),
        (0.3422, 0.01094113, 0.2942527, 0.2842800),
    ]
)
_ISOTROPIC = np.array(
    [(0.0901, 0.0247), (0.1534, 0.0436), (0.2323, 0.0738), (0.3297, 0.1244)]
)

_PUBLISHED_SHRINK = 0.2
"""Shrink in a published script of a robot of this foam; the table names none."""


def published_foam(solid_modulus: float = TPU) -> FoamTable:
    """Return the published table of Polyfoam: a soft axis, or isotropic.

    F. Vanneste et al., IEEE RA-L 5 (2020), doi 10.1109/LRA.2020.2969926. E_stiff is the
    mean of both moduli across the soft axis, which differ by 3 to 9 %. The table names
    no shrink of its anisotropic foam: it is taken to be 0.2, as in a published script
    of the robot that was printed of it. Between this and the isotropic foam there are
    no published values, so moduli there are only interpolated; and relative density is
    taken for the infill percentage.

    Args:
        solid_modulus: Young's modulus of the solid, to which those of a foam are
            proportional; by default that of the published TPU [Pa].

    Raises:
        ValueError: If the modulus is not positive and finite.
    """
    if not (np.isfinite(solid_modulus) and solid_modulus > 0.0):
        raise ValueError(
            "the modulus of the solid must be positive and finite [Pa], got "
            f"{solid_modulus:g}; 12 MPa is that of the published TPU."
        )
    density, soft, *stiff = _STRETCHED.T
    dense, isotropic = _ISOTROPIC.T
    shrink = np.repeat([_PUBLISHED_SHRINK, 1.0], [len(_STRETCHED), len(_ISOTROPIC)])
    return FoamTable(
        "Polyfoam",
        np.concatenate([density, dense]),
        shrink,
        solid_modulus * np.concatenate([soft, isotropic]),
        solid_modulus * np.concatenate([np.mean(stiff, axis=0), isotropic]),
        "homogenised Polyfoam of TPU, Vanneste et al., IEEE RA-L 2020",
    )
