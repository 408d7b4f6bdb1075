"""Find config/ and launch/ in a colcon install space, a pip environment or a source tree."""

from __future__ import annotations

import sys
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted

PACKAGE = "rx90_emulator"
SHIPPED_RIG = "rig/gm8224.yaml"
SOURCE_RIG = "rig/source.yaml"
PRESLIDING_RIG = "rig/presliding.yaml"


def share_directory() -> Path:
    """Return the folder that holds config/ and launch/.

    Order: the source tree (an editable install or a checkout), the ament index (colcon), then
    `share/rx90_emulator` under the environment's prefix (pip), which no ament index knows of.

    Raises:
        ConfigError: if none of them exists.
    """
    source = Path(__file__).resolve().parents[2]
    if (source / "package.xml").is_file() and (source / "config").is_dir():
        return source
    try:
        # The models work where no ROS is installed.
        from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
    except ImportError:
        pass
    else:
        try:
            return Path(get_package_share_directory(PACKAGE))
        except (PackageNotFoundError, LookupError, OSError):
            # OSError: a pip environment does not set AMENT_PREFIX_PATH.
            pass
    prefix = Path(sys.prefix) / "share" / PACKAGE
    if prefix.is_dir():
        return prefix
    raise ConfigError(f"the data folder of {PACKAGE} was not found in {source}, AMENT_PREFIX_PATH or {prefix}")


def config_path(relative: str) -> Path:
    """Return the path of a file that the package ships under config/."""
    return share_directory() / "config" / relative


def resolve_config(name: str, folder: Path | None = None) -> Path:
    """Return the path for a user's entry: a path of their own, or the name of a shipped file under config/.

    Args:
        name: the entry.
        folder: base of a relative path, the present one for None.

    Raises:
        ConfigError: if neither exists.
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
    raise ConfigError(f"no file {quoted(str(name))}: neither {own.absolute()} nor the shipped {shipped} exists")
