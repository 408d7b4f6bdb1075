"""What results depend on beside the plan: the emulator's sources and the libraries under it."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_ROOMS = ("rx90_common", "rx90_controller", "rx90_description", "rx90_loop", "rx90_sim", "rx90_sweep")
_PACKAGES = ("rx90_emulator", "numpy", "scipy", "numba", "pin")


def sources_hash() -> str:
    """Return a hash of all sources that take part in a run."""
    root = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


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
