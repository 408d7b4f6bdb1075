"""The project's own files: its sources with a hash and their versions, and config/ and launch/, wherever they are.

Every command imports this module: what is slow to import, the functions import themselves.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted

PACKAGES = ("rx90_common", "rx90_sim", "rx90_controller", "friction_bench", "rx90_emulator")
"""The Python packages of this project, from the ground to the roof."""

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds them: a checkout or a site-packages folder."""


def project_files() -> list[Path]:
    """Return all source files of this project, sorted."""
    return sorted(file for name in PACKAGES for file in (ROOT / name).rglob("*.py"))


def sources_hash(files: Iterable[Path], salt: str = "") -> str:
    """Return a hash of the contents of `files`, 16 hexadecimal digits."""
    import hashlib

    digest = hashlib.sha256(salt.encode())
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


_LIBRARIES = ("rx90_emulator", "numpy", "scipy", "numba", "pin")


def versions() -> dict[str, str]:
    """Return the versions of the interpreter and of the libraries that decide the results."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": f"{sys.version_info.major}.{sys.version_info.minor}"}
    for package in _LIBRARIES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


PACKAGE = "rx90_emulator"
SHIPPED_RIG = "rig/gm8224.yaml"
SOURCE_RIG = "rig/source.yaml"


def share_directory() -> Path:
    """Return the folder that holds config/ and launch/.

    Order: the source tree (an editable install or a checkout), the ament index (colcon), then
    `share/rx90_emulator` under the environment's prefix (pip), which no ament index knows of.
    """
    if (ROOT / "package.xml").is_file() and (ROOT / "config").is_dir():
        return ROOT
    # The models work where no ROS is installed, and a pip environment does not set AMENT_PREFIX_PATH (OSError).
    with suppress(ImportError, LookupError, OSError):
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(PACKAGE))
    prefix = Path(sys.prefix) / "share" / PACKAGE
    if prefix.is_dir():
        return prefix
    raise ConfigError(
        f"the data folder of {PACKAGE} was not found in {ROOT}, AMENT_PREFIX_PATH or {prefix}"
    )


def config_path(relative: str) -> Path:
    """Return the path of a file that the package ships under config/."""
    return share_directory() / "config" / relative


def resolve_config(name: str, folder: Path | None = None) -> Path:
    """Return the path for a user's entry: a path of their own, or the name of a shipped file under config/.

    Args:
        name: the entry.
        folder: base of a relative path, the present one for None.
    """
    try:
        own = (folder or Path()) / Path(name).expanduser()
    except RuntimeError as error:
        raise ConfigError(f"no file {quoted(str(name))}: its home folder does not exist") from error
    shipped = config_path(name)
    try:
        if own.is_file():
            return own
        if shipped.is_file():
            return shipped
    except OSError as error:  # a name longer than the system takes, a folder that may not be read
        raise ConfigError(f"no file {quoted(str(name))}: {error.strerror}") from error
    raise ConfigError(
        f"no file {quoted(str(name))}: neither {own.absolute()} nor the shipped {shipped} exists"
    )
