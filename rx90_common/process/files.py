"""Files that appear whole: written beside their places first, then given their names."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from rx90_common.base.errors import write_error
from rx90_common.process.interrupts import interrupts_later

_LONGEST_PREFIX = 50  # characters of a name, which may take four bytes each
_MARK = ".rx90-"
_RANDOM = "?" * 8  # of `mkdtemp`


@contextmanager
def hidden_beside(target: Path) -> Iterator[Path]:
    """Yield a new hidden folder beside a file or folder that is being made; it goes with the block.

    Its process holds a lock on it, which a kill releases: folders that were left so are swept first.

    Raises:
        OSError: if none can be made.
    """
    _sweep(target.parent)
    prefix = f".{target.name[:_LONGEST_PREFIX]}{_MARK}"
    held = None
    while held is None:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
        with suppress(FileNotFoundError):  # swept between its making and its lock
            held = _lock(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(held)


def _sweep(parent: Path) -> None:
    for left in parent.glob(f".*{_MARK}{_RANDOM}"):
        with suppress(OSError):  # somebody else's
            held = _lock(left, wait=False)
            shutil.rmtree(left, ignore_errors=True)
            os.close(held)


def _lock(folder: Path, *, wait: bool = True) -> int:
    """Return a descriptor of a folder that holds its lock; on a file system without locks, with `wait`, it holds none.

    Raises:
        OSError: if the folder is gone; without `wait`, if another process has the lock.
    """
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            if not wait:
                raise
        folder.lstat()
    except OSError:
        os.close(held)
        raise
    return held


@contextmanager
def written_beside(*files: Path) -> Iterator[list[Path]]:
    """Yield where to write the new contents of files; after the block all of these get their names, or none.

    Until then, and after an error, an interrupt or a kill, what stood under the names still does. Files that exist keep
    their permissions, links stay links, and what is no file, such as a device, is written into as it is.

    Raises:
        Rx90Error: if that fails, as `write_error` says.
    """
    current = files[0]
    try:
        with ExitStack() as folders:
            places: list[tuple[Path, Path]] = []
            for current in files:
                if current.exists() and not current.is_file() and not current.is_dir():
                    places.append((current, current))
                else:
                    target = current.resolve()
                    places.append((_beside(target, folders), target))
            yield [place for place, _ in places]
            # All names or none; an interrupt that comes so late has nothing left to stop.
            with suppress(KeyboardInterrupt), interrupts_later():
                for file, (place, target) in zip(files, places, strict=True):
                    current = file
                    if place != target:
                        _give_name(place, target)
    except OSError as error:
        raise write_error(current, error) from error


def _beside(target: Path, folders: ExitStack) -> Path:
    """Return a place of the same name in a new hidden folder."""
    if target.exists():
        with target.open("ab"):  # what may not be written may not be replaced either
            pass
    return folders.enter_context(hidden_beside(target)) / target.name


def _give_name(place: Path, target: Path) -> None:
    with suppress(OSError):  # there is none before, or it belongs to somebody else
        shutil.copymode(target, place)
    place.replace(target)


def write_text(file: Path, text: str) -> None:
    """Write a file as UTF-8, as `write_bytes` does."""
    write_all({file: text.encode()})


def write_bytes(file: Path, content: bytes) -> None:
    """Write a file; where that fails an old one stays as it was, and no new one.

    Raises:
        Rx90Error: if that fails, as `write_error` says.
    """
    write_all({file: content})


def write_all(contents: Mapping[Path, bytes]) -> None:
    """Write all files or none.

    Raises:
        Rx90Error: if one cannot be written; every file that existed is as it was.
    """
    with written_beside(*contents) as places:
        for place, (file, content) in zip(places, contents.items(), strict=True):
            try:
                place.write_bytes(content)
            except OSError as error:
                raise write_error(file, error) from error
