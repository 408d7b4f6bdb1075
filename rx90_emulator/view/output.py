"""Where the page writes: beneath one folder that the command line names, and over no file without a confirmation."""

from __future__ import annotations

import stat
from pathlib import Path

from rx90_common.base.errors import ConfigError, write_error
from rx90_common.base.quoting import plain, quoted


class ExistingFileError(ConfigError):
    """A file stands under the name; a user who confirms it may have it replaced."""


class OutputFolder:
    """A folder, and what a user of the page may name in it.

    Args:
        folder: made where it is missing.

    Raises:
        Rx90Error: where it cannot be made, as `write_error` says.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.folder = folder.resolve(strict=True)
        except OSError as error:
            raise write_error(folder, error, "a folder that exists or can be made") from error

    def path_for(self, name: str, *, replace: bool = False) -> Path:
        """Return the path of a file or bag to be written; `name` may go through folders that exist in this one.

        Links are refused, and names with a part that begins with a dot: they lead out of the folder, or to files
        that other programs obey.

        Args:
            name: as the user types it.
            replace: the user has confirmed that a file of this name is replaced.

        Raises:
            ExistingFileError: where a file stands there, and nobody has confirmed that it goes.
            ConfigError: for every other name that is not free, or leads elsewhere.
        """
        accepted = f"a new name beneath {plain(self.folder)}"
        hidden = any(part.startswith(".") for part in name.split("/"))
        if hidden or not name.strip() or not name.isprintable() or Path(name).is_absolute():
            raise ConfigError(f"{quoted(name)}; accepted: {accepted}, without parts that begin with a dot")
        path = self.folder / name
        try:
            if path.parent.resolve() != path.parent or not path.parent.is_dir():
                raise ConfigError(f"{quoted(name)} leads through a link, or no folder; accepted: {accepted}")
            there = path.lstat()
        except FileNotFoundError:
            return path
        except OSError as error:
            raise ConfigError(f"{quoted(name)}: {error.strerror}; accepted: {accepted}") from error
        if not stat.S_ISREG(there.st_mode):
            raise ConfigError(f"{quoted(name)} is no plain file; accepted: {accepted}")
        if not replace:
            raise ExistingFileError(f"{plain(path)} exists; accepted: {accepted}")
        return path
