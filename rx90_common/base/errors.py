"""The errors for users, and the exit codes of the commands; each text is one line with the offending value."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from rx90_common.base.quoting import one_line, plain

DONE = 0
VERDICT_NO = 1
"""Completed with a negative verdict: differs, not confirmed, lost messages."""
REFUSED = 2
"""Wrong usage or bad input; nothing was written."""
FAILED = 3
"""Could not be carried out: nodes ended, disk full."""
INTERRUPTED = 130
DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}

_LONGEST_BAG_NAME = 255 - len(".db3-journal")  # bytes; file systems take names of 255


class Rx90Error(Exception):
    """Root of all errors of this project; its text is one line meant for the user."""

    exit_code: ClassVar[int] = REFUSED

    def __str__(self) -> str:
        """Return the text; one line of bounded length also where a part came from outside and nobody quoted it."""
        return one_line(super().__str__())


class FailureError(Rx90Error):
    """The request is acceptable and could not be carried out."""

    exit_code = FAILED


@contextmanager
def located(where: object, kind: type[Rx90Error] = Rx90Error) -> Iterator[None]:
    """Let the refusals of a block, of a kind, begin with their place, such as a file, where they do not name it yet."""
    try:
        yield
    except kind as error:
        if str(error).startswith(f"{where}: "):
            raise
        raise type(error)(f"{where}: {error}") from error


class Rx90Warning(UserWarning):
    """What runs, and means less than it seems to; commands print it as one line."""


def warn_caller(lines: Iterable[str]) -> None:
    """Give each line as an Rx90Warning of the place from which this project was called."""
    for line in lines:
        depth = 1
        frame = sys._getframe()
        while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("rx90_"):
            depth = depth + 1
            frame = frame.f_back
        warnings.warn(line, Rx90Warning, stacklevel=depth)


class ConfigError(Rx90Error):
    """A parameter or a configuration file is not acceptable."""


class DivergenceError(FailureError):
    """The plant's state left the range in which the model means anything."""


class SupervisionError(FailureError):
    """The controller's supervision has cut the power; the text names joint, value, limit and time."""


class TrajectoryError(Rx90Error):
    """A trajectory is refused; the text names joint, index and reason."""


class LineError(Rx90Error):
    """A Cartesian line cannot be travelled; the text names the place on the line."""


class ExchangeError(FailureError):
    """Two nodes do not speak the same exchange (names, sizes, rates), or one of them does not answer."""


class MessageError(ExchangeError):
    """One message cannot be used; the next one may be."""


class ProcessError(FailureError):
    """A child process ended early or did not print the expected text."""


class OutputError(FailureError):
    """Standard output or a file cannot be written."""


def write_error(path: object, error: OSError) -> Rx90Error:
    """Return why a file cannot be written: refused for its path, or failed for a disk that is full or broken."""
    kind = OutputError if error.errno in DISK_ERRORS else ConfigError
    return kind(f"{plain(path)}: cannot be written ({error.strerror})")


def check_place(path: Path) -> None:
    """Refuse a file or folder that cannot be created, before the work whose result it is to contain.

    The file is created as a test: permissions do not reveal read-only, full and virtual file systems, nor limit root.
    Devices and pipes accept data.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            return
        parent = next(parent for parent in path.absolute().parents if parent.exists())
        with TemporaryDirectory(prefix=".rx90_", dir=parent):
            pass
    except OSError as error:
        raise write_error(path, error) from error


def check_replaced(path: Path, *, force: bool, kind: type[Rx90Error] | None = None) -> None:
    """Refuse a file that exists, by a ConfigError or another kind, unless --force was given."""
    if path.exists() and not force:
        raise (kind or ConfigError)(
            f"{plain(path)} exists; accepted: another name, or --force to replace it"
        )


def check_bag_name(path: Path) -> None:
    """Refuse a bag's name to which its file, which is named after it, cannot add its suffix and that of a journal."""
    size = len(os.fsencode(path.name))
    if size > _LONGEST_BAG_NAME:
        raise BagError(
            f"{plain(path)}: its name has {size} bytes; accepted: up to {_LONGEST_BAG_NAME}"
        )


def check_type(**given: tuple[object, type]) -> None:
    """Refuse arguments, given with their values and types, such as those of a call in the wrong order.

    Raises:
        TypeError: naming the argument, its type and the one that is accepted.
    """
    for name, (value, kind) in given.items():
        if not isinstance(value, kind):
            raise TypeError(f"{name} is of type {type(value).__name__}; accepted: {kind.__name__}")


class BagError(Rx90Error):
    """A bag cannot be made, read or compared."""


class BagWriteError(FailureError, BagError):
    """A bag cannot be written any further; data written before stay."""


class IdentificationError(Rx90Error):
    """The data do not carry an estimate; a refusal is the answer, never a number."""


class SweepError(Rx90Error):
    """A sweep's plan or its file of results is not acceptable."""
