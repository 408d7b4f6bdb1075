"""The project's own source files, a hash of some of them, and its versions."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("rx90_common", "rx90_sim", "rx90_controller", "friction_bench", "rx90_emulator")
"""The Python packages of this project, from the ground to the roof."""

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds them: a checkout or a site-packages folder."""

_IMPORT = re.compile(r"^\s*(?:from (\S+) import ([^\n(]*(?:\([^)]*\))?)|import (\S+))", re.MULTILINE)


@cache
def module_file(name: str) -> Path | None:
    """Return the file of a module of this project, None for any other name."""
    parts = name.split(".")
    if parts[0] not in PACKAGES:
        return None
    path = ROOT.joinpath(*parts)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def importers_of(package: str) -> list[Path]:
    """Return the project's files that import from `package`, sorted."""
    pattern = re.compile(rf"^\s*from {re.escape(package)}[. ]", re.MULTILINE)
    files = (file for name in PACKAGES for file in (ROOT / name).rglob("*.py"))
    return sorted(file for file in files if pattern.search(file.read_text(encoding="utf-8")))


def with_imports(files: Iterable[Path]) -> list[Path]:
    """Return `files` and all files of this project that they import, directly or not, sorted."""
    found: set[Path] = set()
    todo = list(files)
    while todo:
        file = todo.pop()
        if file not in found:
            found.add(file)
            todo.extend(_imported(file))
    return sorted(found)


@cache
def _imported(source: Path) -> list[Path]:
    files = []
    for base, items, plain in _IMPORT.findall(source.read_text(encoding="utf-8")):
        names = [f"{base}.{item}" for item in re.findall(r"\w+", items)] if base else []
        files += [file for name in (base, *names, plain) if name and (file := module_file(name))]
    return files


def sources_hash(files: Iterable[Path], salt: str = "") -> str:
    """Return a hash of the contents of `files`, 16 hexadecimal digits."""
    digest = hashlib.sha256(salt.encode())
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


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
