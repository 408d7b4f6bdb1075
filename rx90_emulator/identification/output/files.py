"""Write all of several files or none, and check beforehand that it can succeed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from rx90_common.base.errors import IdentificationError, check_place, write_error
from rx90_common.process.files import write_all


def check_targets(files: Sequence[Path], *, force: bool) -> None:
    """Refuse files that could not be written in the end, before anything long begins.

    Raises:
        IdentificationError: for a file that exists without `force`, is none that can be replaced, or whose folder
            is missing.
        Rx90Error: for a folder that takes no file, as `check_place` says.
    """
    for file in files:
        folder = file.absolute().parent
        try:
            file.lstat()
        except FileNotFoundError:
            pass
        except OSError as error:
            raise write_error(file, error) from error
        if file.exists() and not file.is_file():
            kind = "a folder" if file.is_dir() else "no regular file"
            raise IdentificationError(f"{file} is {kind}; accepted: the name of a file")
        if file.exists() and not force:
            raise IdentificationError(f"{file} exists; accepted: another name, or --force to replace it")
        if not folder.is_dir():
            raise IdentificationError(f"{file}: the folder {folder} does not exist; accepted: a file in one that does")
        check_place(file)


def check_folder(folder: Path, names: Iterable[str], *, force: bool) -> None:
    """Refuse a folder that these files could not be written into in the end, as `check_targets` does for files.

    The folder need not exist, the one above it must. What else is in it stays.

    Raises:
        IdentificationError: for what is no folder, a file that exists without `force`, or a place that takes none.
    """
    if folder.is_dir():
        check_targets([folder / name for name in names], force=force)
    elif folder.exists():
        raise IdentificationError(f"{folder} is no folder; accepted: the name of a folder")
    else:
        check_targets([folder], force=force)


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write all files into a folder or none; a folder that is not there is made.

    Raises:
        Rx90Error: if that fails; every file that existed is as it was.
    """
    made = not folder.is_dir()
    try:
        folder.mkdir(exist_ok=True)
        write_all({folder / name: text.encode() for name, text in texts.items()})
    except BaseException as error:
        if made:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise write_error(folder, error) from error
        raise
