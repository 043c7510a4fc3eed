"""The keys of a project file that make the material."""

from typing import Literal

from pydantic import Field

from softcal_jax.project._laws import CONSTANTS
from softcal_jax.project._table import Angle, Density, Number, Pressure, Table


class RegionTable(Table):
    """Other constants in one tet group."""

    E: Pressure | None = None
    nu: Number | None = None
    E_t: Pressure | None = None
    E_l: Pressure | None = None
    nu_t: Number | None = None
    nu_tl: Number | None = None
    mu_l: Pressure | None = None
    theta: Angle | None = None
    phi: Angle | None = None
    density: Density | None = None


class MaterialTable(Table):
    """The law and its constants before calibration; `_laws` tells which it needs."""

    law: Literal[
        "neo-hookean",
        "corotational",
        "classical-corotational",
        "st-venant-kirchhoff",
        "fibre-reinforced",
    ] = Field(
        description='"neo-hookean", "corotational", "st-venant-kirchhoff" or '
        '"fibre-reinforced"'
    )
    elasticity: (
        Literal["isotropic", "transverse-isotropic", "reduced-transverse-isotropic"]
        | None
    ) = None
    E: Pressure | None = None
    nu: Number | None = None
    E_t: Pressure | None = None
    E_l: Pressure | None = None
    nu_t: Number | None = None
    nu_tl: Number | None = None
    mu_l: Pressure | None = None
    theta: Angle | None = None
    phi: Angle = 0.0
    print_plane: Literal["xy", "xz", "yz"] | None = None
    density: Density = Field(description=CONSTANTS["density"].words)
    formulation: Literal["auto", "displacement", "mean-dilatation"] = "auto"
    regions: dict[str, RegionTable] = Field(default_factory=dict)
