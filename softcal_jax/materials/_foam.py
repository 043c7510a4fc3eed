"""Homogenised moduli of printed foams, and the foam that has given moduli."""

from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np

from softcal_jax._module import Module, one_line
from softcal_jax._typing import Float, HostArray
from softcal_jax.materials._foam_patch import FoamPatch

Infill = Literal["Polyfoam", "Phasor"]
"""Foams of the slicer IceSL, by its names."""

AxisKind = Literal["soft", "stiff"]


class FoundFoam(NamedTuple):
    """The foams whose moduli are nearest to those asked for.

    Attributes:
        density: Relative density [-].
        anisotropy: Shrink of Polyfoam, isotropy of Phasor [-].
        E_soft: Modulus along the soft axis, or in the soft plane [Pa].
        E_stiff: Modulus along the stiff axis, or in the stiff plane [Pa].
        error: The larger of both moduli's relative distances from what was asked for:
            |ln(found / asked)| [-].
    """

    density: Float[HostArray, " n"]
    anisotropy: Float[HostArray, " n"]
    E_soft: Float[HostArray, " n"]
    E_stiff: Float[HostArray, " n"]
    error: Float[HostArray, " n"]

    __repr__ = one_line


class FoamTable(Module):
    """Moduli of a foam by its density and the setting that makes it anisotropic.

    Samples with the same anisotropy are a level. Along a level ln E is a monotone cubic
    of ln density, which is a straight line where E is a power of the density. Between
    two levels ln density and ln E are linear, for Polyfoam in ln shrink and for Phasor
    in its isotropy; the ends of the levels join, and what lies outside of this patch
    is not reached by the foam.

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
    density: Float[HostArray, " n"] = eqx.field(converter=np.asarray)
    anisotropy: Float[HostArray, " n"] = eqx.field(converter=np.asarray)
    E_soft: Float[HostArray, " n"] = eqx.field(converter=np.asarray)
    E_stiff: Float[HostArray, " n"] = eqx.field(converter=np.asarray)
    source: str = eqx.field(static=True, default="a table of the user")

    AXES: ClassVar[dict[str, AxisKind]] = {"Polyfoam": "soft", "Phasor": "stiff"}

    def __check_init__(self):
        if self.infill not in self.AXES:
            raise ValueError(
                f'infill must be "Polyfoam" or "Phasor", got {self.infill!r}.'
            )
        self._check_values()
        for level in np.unique(self.anisotropy):
            densities = self.density[self.anisotropy == level]
            if len(np.unique(densities)) < max(len(densities), 2):
                raise ValueError(
                    f"foam table: at {self.setting} {level:g} it has the densities "
                    f"{', '.join(f'{d:g}' for d in densities)}; expected two or more, "
                    "each once, since moduli are interpolated between them."
                )

    def _check_values(self) -> None:
        columns = {
            "density": (self.density, (self.density > 0.0) & (self.density <= 1.0)),
            self.setting: (self.anisotropy, self._has_coordinate()),
            "E_soft": (self.E_soft, self.E_soft > 0.0),
            "E_stiff": (self.E_stiff, self.E_stiff >= self.E_soft),
        }
        expected = {
            "density": "in (0, 1]: the share of solid, 0.2 for 20 %",
            self.setting: "in (0, 1]" if self._is_log else "in [0, 1]",
            "E_soft": "positive [Pa]",
            "E_stiff": "finite and at least E_soft [Pa]",
        }
        for name, (values, fine) in columns.items():
            bad = np.flatnonzero(~(fine & np.isfinite(values)))
            if bad.size:
                raise ValueError(
                    f"foam table, sample {bad[0] + 1}: {name} must be "
                    f"{expected[name]}, got {values[bad[0]]:g}."
                )

    def _has_coordinate(self):
        positive = self.anisotropy > 0.0 if self._is_log else self.anisotropy >= 0.0
        return positive & (self.anisotropy <= 1.0)

    @property
    def setting(self) -> str:
        """What the anisotropy is called for this infill."""
        return "shrink" if self.infill == "Polyfoam" else "iso"

    @property
    def axis(self) -> AxisKind:
        """Which modulus holds along the single axis; the other holds across it."""
        return self.AXES[self.infill]

    @property
    def _is_log(self) -> bool:
        return self.infill == "Polyfoam"

    def moduli(
        self,
        density: Float[HostArray, " n"],
        anisotropy: Float[HostArray, " n"],
    ) -> Float[HostArray, "n 2"]:
        """Interpolate E_soft and E_stiff [Pa].

        Args:
            density: Relative density [-]; outside the table the curves go on.
            anisotropy: Shrink or isotropy [-]; that of the nearest level outside.
        """
        return self._patch().moduli(density, anisotropy)

    def find(
        self,
        E_soft: Float[HostArray, " n"],
        E_stiff: Float[HostArray, " n"],
    ) -> FoundFoam:
        """Find the foams whose moduli are nearest, in the logarithms of both.

        The nearest of many samples starts a Gauss-Newton search within the table, so
        that every value has an answer; its `error` says how far that is off.

        Args:
            E_soft: The smaller modulus [Pa].
            E_stiff: The larger modulus [Pa].
        """
        # Each pair once: fields have few values per tet. Complex numbers sort as pairs.
        pairs, index = np.unique(E_soft + 1j * E_stiff, return_inverse=True)
        asked = np.log(np.stack([pairs.real, pairs.imag], axis=1))
        anisotropy, found = self._patch().nearest(asked)
        error = np.abs(found[:, 1:] - asked).max(axis=1)
        density, soft, stiff = np.exp(found).T
        each = (density, anisotropy, soft, stiff, error)
        return FoundFoam(*(values[index] for values in each))

    def _patch(self) -> FoamPatch:
        moduli = np.stack([self.E_soft, self.E_stiff], axis=1)
        return FoamPatch(self.density, self.anisotropy, moduli, is_log=self._is_log)
