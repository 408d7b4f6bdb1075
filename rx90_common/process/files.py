"""Output: files that appear complete, made beside their places; and standard output that cannot be written."""

from __future__ import annotations

import io
import os
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rx90_common.base.errors import OutputError, write_error
from rx90_common.process.interrupts import deferred_interrupts

_LONGEST_PREFIX = 50  # characters of a name, which may take four bytes each
_BROKEN_PIPE_CODE = 141  # as a shell reports the end by SIGPIPE


@contextmanager
def hidden_folder(target: Path) -> Iterator[Path]:
    """Yield a new hidden folder beside a file or folder that is being made; it is removed at the end of the block.

    A process that is killed leaves it behind.

    Raises:
        OSError: if none can be made.
    """
    prefix = f".{target.name[:_LONGEST_PREFIX]}.rx90-"
    with TemporaryDirectory(prefix=prefix, dir=target.parent, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@contextmanager
def atomic_files(*files: Path) -> Iterator[list[Path]]:
    """Yield paths for the new contents of files; after the block all of these get their names, or none.

    Until then, and after an error, an interrupt or a kill, the old files are unchanged. Files that exist keep
    their permissions, links stay links, and other paths, such as devices, are written to directly.
    """
    current = files[0]
    try:
        with ExitStack() as folders:
            places: list[tuple[Path, Path]] = []
            for current in files:
                place = target = current.resolve()
                if current.is_file() or current.is_dir() or not current.exists():
                    if target.exists():
                        # a file that may not be written may not be replaced either
                        with target.open("ab"):
                            pass
                    place = folders.enter_context(hidden_folder(target)) / target.name
                places.append((place, target))
            yield [place for place, _ in places]
            # All names or none; an interrupt that comes so late has nothing left to stop.
            with suppress(KeyboardInterrupt), deferred_interrupts():
                for file, (place, target) in zip(files, places, strict=True):
                    current = file
                    if place != target:
                        # there is none before, or it belongs to somebody else
                        with suppress(OSError):
                            shutil.copymode(target, place)
                        place.replace(target)
    except OSError as error:
        raise write_error(current, error) from error


def file_stem(name: str) -> str:
    """Return the name of a robot or a joint as part of a file's name: no folder, no hidden file, no option."""
    return re.sub(r"^[-.]|[/\\:]", "_", name)


def write_text(file: Path, text: str) -> None:
    """Write a file as UTF-8, as `write_all` does."""
    write_all({file: text.encode()})


def write_all(contents: Mapping[Path, bytes]) -> None:
    """Write all files or none."""
    with atomic_files(*contents) as places:
        for place, (file, content) in zip(places, contents.items(), strict=True):
            try:
                place.write_bytes(content)
            except OSError as error:
                raise write_error(file, error) from error


class _Output(io.FileIO):
    """Standard output; once it has failed, further output is discarded, or Python would report an error at the end."""

    _failed = False

    def write(self, data: Any) -> int:
        if self._failed:
            return len(data)
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            self._failed = True
            raise SystemExit(_BROKEN_PIPE_CODE) from None
        except OSError as error:
            self._failed = True
            raise OutputError(f"standard output cannot be written: {error.strerror}") from error


def check_output() -> None:
    """From now on raise OutputError where standard output cannot be written, and SystemExit after a closed pipe."""
    if sys.stdout is None:
        # Closed by the parent: the next file that is opened would get its number.
        os.open(os.devnull, os.O_WRONLY)
        return
    before = sys.stdout
    before.flush()
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(_Output(1, "wb", closefd=False)),
        encoding=before.encoding,
        # A locale without the character must not end the command.
        errors=before.errors if before.encoding.lower() == "utf-8" else "backslashreplace",
        # python -u
        line_buffering=bool(before.line_buffering or getattr(before, "write_through", False)),
    )


@contextmanager
def made_folder(folder: Path) -> Iterator[Path]:
    """Make a folder, with those above it, unless it is there; one that stays empty is removed again.

    Raises:
        OutputError: for a place where none can be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(folder, error) from error
    try:
        yield folder
    finally:
        # An empty folder would block the next attempt.
        with suppress(OSError):
            folder.rmdir()
