"""What results depend on beside the plan: the emulator's sources and the libraries under it."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from rx90_common.base.sources import ROOT, sources_hash, with_imports

_PACKAGES = ("rx90_emulator", "numpy", "scipy", "numba", "pin")


def run_hash() -> str:
    """Return a hash of all sources that take part in a run."""
    return sources_hash(with_imports([ROOT / "rx90_emulator/sweep/execution.py"]))


def versions() -> dict[str, str]:
    """Return the versions of the interpreter and of the libraries that decide the results."""
    major, minor, _ = platform.python_version_tuple()
    found = {"python": f"{major}.{minor}"}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found
