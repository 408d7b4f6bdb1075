"""Which versions a result was computed with."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("rx90_emulator", "numpy", "scipy", "numba", "pin")


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
