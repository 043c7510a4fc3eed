"""The file of a foam table."""

import csv
import os
from pathlib import Path

from softcal_jax.configurations import read_table
from softcal_jax.designs._foam import FoamTable, Infill, published_foam

_UNITS = {"kPa": 1e3, "Pa": 1.0, "MPa": 1e6}


def foam_table(infill: Infill, path: str | os.PathLike[str] | None = None) -> FoamTable:
    """Return the foam table in a file, or the published one of the infill.

    Raises:
        ValueError: If none is published, or the file is no such table.
    """
    if path is not None:
        return read_foam_table(path, infill)
    if infill == "Phasor":
        raise ValueError(
            "no moduli of Phasor are published: give a table of your own, from test "
            "prints, with the columns density, iso, E_soft_kPa and E_stiff_kPa "
            "(table=, --table)."
        )
    return published_foam()


def read_foam_table(path: str | os.PathLike[str], infill: Infill) -> FoamTable:
    """Read a foam table of the user, from own tests or homogenisation.

    The file has one line per sample and the columns `density` (share of solid, 0.2 for
    20 %), `shrink` for Polyfoam or `iso` for Phasor (from 0 to 1, where 1 is
    isotropic), `E_soft_kPa` and `E_stiff_kPa` (or `_Pa`, `_MPa`). At each shrink or iso
    there must be two densities or more. `write_foam_table` writes one to start from.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no such table; the text says what is wrong where.
    """
    path = Path(path)
    table = read_table(path, "density", None)
    known = (unit for unit in _UNITS if f"E_soft_{unit}" in table.header)
    unit = next(known, "kPa")
    setting = "iso" if infill == "Phasor" else "shrink"
    columns = ["density", setting, f"E_soft_{unit}", f"E_stiff_{unit}"]
    table.check_columns(columns)
    density, anisotropy, soft, stiff = table.numbers(columns).T
    moduli = _UNITS[unit] * soft, _UNITS[unit] * stiff
    try:
        return FoamTable(infill, density, anisotropy, *moduli, source=path.name)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_foam_table(path: Path, table: FoamTable) -> None:
    """Write a foam table as `read_foam_table` reads it, in kPa."""
    moduli = 1e-3 * table.E_soft, 1e-3 * table.E_stiff
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["density", table.setting, "E_soft_kPa", "E_stiff_kPa"])
        for row in zip(table.density, table.anisotropy, *moduli, strict=True):
            writer.writerow([f"{value:.9g}" for value in row])
