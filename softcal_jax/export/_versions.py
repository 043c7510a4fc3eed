"""Versions of what a result was computed with."""

import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax

from softcal_jax.equilibrium import Model

_PACKAGES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "jaxopt")


def versions(model: Model) -> dict[str, str]:
    """List versions of Python and the numerical packages, and the machine.

    Args:
        model: The model, whose sparse solver names its package.

    Returns:
        Name to version, with `platform`, `cpu` and `device` of JAX.
    """
    packages = [*_PACKAGES, *re.findall(r"\((.+)\)", model.solver.name)]
    return {
        "python": platform.python_version(),
        "softcal_jax": _version("softcal-jax"),
        **{name: _version(name) for name in packages},
        "platform": platform.platform(),
        "cpu": _cpu(),
        "device": jax.devices()[0].device_kind,
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"  # run from a checkout


def _cpu() -> str:
    info = Path("/proc/cpuinfo")  # Linux; elsewhere `platform` knows
    if info.exists():
        found = re.search(r"(?m)^model name\s*: (.+)$", info.read_text())
        if found:
            return found.group(1).strip()
    return platform.processor() or platform.machine()
