"""Homogenised moduli of printed foams, and the foam that has given moduli."""

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import numpy as np

from softcal_jax._module import Module, one_line
from softcal_jax._names import unknown_name
from softcal_jax.exchange.icesl._foam_patch import FoamPatch, Numbers, Pairs

Infill = Literal["Polyfoam", "Phasor"]
"""Foams of the slicer IceSL, by its names."""


class FoundFoam(NamedTuple):
    """The foams whose moduli are nearest to those asked for.

    Attributes:
        density: Relative density [-].
        anisotropy: As in `FoamTable` [-].
        E_soft: Modulus along the soft axis, or in the soft plane [Pa].
        E_stiff: Modulus along the stiff axis, or in the stiff plane [Pa].
        error: The larger |ln(found / asked)| of both moduli [-].
    """

    density: Numbers
    anisotropy: Numbers
    E_soft: Numbers
    E_stiff: Numbers
    error: Numbers

    __repr__ = one_line


class FoamTable(Module):
    """Moduli of a foam by its density and the setting that makes it anisotropic.

    Samples with the same anisotropy are a level. Along a level ln E is a monotone cubic
    of ln density: a straight line where E is a power of the density. Between two levels
    ln density and ln E are linear, for Polyfoam in ln shrink and for Phasor in its
    isotropy; what lies outside of this patch is not reached by the foam.

    Attributes:
        infill: The foam. Polyfoam has a soft axis and a stiff plane across it; Phasor
            has a stiff axis and a soft plane.
        density: Share of solid [-], in (0, 1].
        anisotropy: `kgon_x_shrink` of Polyfoam, in (0, 1], or `phasor_infill_iso` of
            Phasor, in [0, 1]; 1 is isotropic [-].
        E_soft: Young's modulus along the soft axis, or in the soft plane [Pa].
        E_stiff: Young's modulus along the stiff axis, or in the stiff plane [Pa].
        source: Where the numbers come from.

    Raises:
        ValueError: If the infill is unknown, a value is out of its range, E_soft
            exceeds E_stiff, or a level has fewer than two densities.
    """

    infill: Infill = eqx.field(static=True)
    density: Numbers = eqx.field(converter=np.asarray)
    anisotropy: Numbers = eqx.field(converter=np.asarray)
    E_soft: Numbers = eqx.field(converter=np.asarray)
    E_stiff: Numbers = eqx.field(converter=np.asarray)
    source: str = eqx.field(static=True, default="a table of the user")

    def __check_init__(self):
        if self.infill not in get_args(Infill):
            raise unknown_name("infill", self.infill, get_args(Infill))
        density, shrink, soft = self.density, self.anisotropy, self.E_soft
        above, low = (shrink > 0.0, "(0") if self._is_log else (shrink >= 0.0, "[0")
        share = "in (0, 1]: the share of solid, 0.2 for 20 %"
        at_least = self.E_stiff, self.E_stiff >= soft, "finite and at least E_soft [Pa]"
        for name, values, fine, expected in (
            ("density", density, (density > 0.0) & (density <= 1.0), share),
            (self.setting, shrink, above & (shrink <= 1.0), f"in {low}, 1]"),
            ("E_soft", soft, soft > 0.0, "positive [Pa]"),
            ("E_stiff", *at_least),
        ):
            bad = np.flatnonzero(~(fine & np.isfinite(values)))
            if bad.size:
                raise ValueError(
                    f"foam table, sample {bad[0] + 1}: {name} must be {expected}, got "
                    f"{values[bad[0]]:g}."
                )
        for level in np.unique(shrink):
            densities = density[shrink == level]
            if len(np.unique(densities)) < max(len(densities), 2):
                raise ValueError(
                    f"foam table: at {self.setting} {level:g} it has the densities "
                    f"{', '.join(f'{d:g}' for d in densities)}; expected two or more, "
                    "each once, since moduli are interpolated between them."
                )

    @property
    def setting(self) -> str:
        """What the anisotropy is called for this infill."""
        return "shrink" if self._is_log else "iso"

    @property
    def axis(self) -> Literal["soft", "stiff"]:
        """Which modulus holds along the single axis; the other holds across it."""
        return "soft" if self._is_log else "stiff"

    @property
    def _is_log(self) -> bool:
        return self.infill == "Polyfoam"

    def moduli(self, density: Numbers, anisotropy: Numbers) -> Pairs:
        """Interpolate E_soft and E_stiff [Pa].

        Outside the table the curves of the density go on, and the nearest level counts.
        """
        return self._patch().moduli(density, anisotropy)

    def find(self, E_soft: Numbers, E_stiff: Numbers) -> FoundFoam:
        """Find the foams whose moduli [Pa] are nearest, in the logarithms of both.

        The nearest of many samples starts a Gauss-Newton search within the table, so
        that every value has an answer; its `error` says how far that is off.
        """
        # Each pair once: fields have few values per tet. Complex numbers sort as pairs.
        pairs, index = np.unique(E_soft + 1j * E_stiff, return_inverse=True)
        asked = np.log(np.stack([pairs.real, pairs.imag], axis=1))
        anisotropy, found = self._patch().nearest(asked)
        error = np.abs(found[:, 1:] - asked).max(axis=1)
        density, *moduli = np.exp(found).T
        values = (density, anisotropy, *moduli, error)
        return FoundFoam(*(each[index] for each in values))

    def _patch(self) -> FoamPatch:
        moduli = np.stack([self.E_soft, self.E_stiff], axis=1)
        return FoamPatch(self.density, self.anisotropy, moduli, is_log=self._is_log)


TPU = 12e6
"""Young's modulus of the printed solid of the published tables [Pa]."""

# As in the authors' published scenes: the relative density, and Ex, Ey and Ez over E of
# the solid, with x the soft axis; for the isotropic foam the mean modulus.
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


def published_foam(solid_modulus: float = TPU) -> FoamTable:
    """Return the published table of Polyfoam: a soft axis, or isotropic.

    F. Vanneste et al., "Anisotropic soft robots based on 3D printed meso-structured
    materials", IEEE RA-L 5 (2020), doi 10.1109/LRA.2020.2969926. E_stiff is the
    mean of both moduli across the soft axis, which differ by 3 to 9 %. The table names
    no shrink of its anisotropic foam: it is taken to be 0.2, as in a published script
    of the robot that was printed of it. Between this and the isotropic foam there are
    no published values, so moduli there are only interpolated; and relative density is
    taken for the infill percentage.

    Moduli of a foam are proportional to that of the solid [Pa], by default that of the
    published TPU.

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
