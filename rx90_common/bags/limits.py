"""What files may unpack to, checked before it is unpacked; and errors of the libraries that read them as one kind."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from backports import zstd
from numpy.typing import NDArray

from rx90_common.base.errors import BagError, Rx90Error, write_error
from rx90_common.base.quoting import plain

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
MAX_MESSAGE_BYTES: Final = 16 << 20
_MAX_WHOLE_BYTES = 256 << 20  # of all parts of a file, or
_MAX_WHOLE_FACTOR = 50  # times its size
ARRAYS_FACTOR: Final = 4
"""The same for arrays, which are all in memory at once."""
_COPY_BYTES = 1_048_576


class DamagedError(BagError):
    """A file contradicts itself; the text names the place, and who opened the file prefixes its name."""

    def __str__(self) -> str:
        return f"is damaged: {super().__str__()}"


@contextmanager
def library_errors(where: str = "") -> Iterator[None]:
    """Make one BagError of whatever a library raises for a file that it cannot read."""
    try:
        yield
    except Rx90Error:
        raise
    except Exception as error:  # the libraries have no common error
        if isinstance(error, OSError) and error.strerror:
            raise BagError(f"cannot be read ({error.strerror})") from error
        text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        raise DamagedError(plain(where + text, 300)) from error


def check_length(noun: str, length: int, most: int) -> None:
    """Refuse what would unpack to more bytes than that, before it is unpacked."""
    if length > most:
        raise DamagedError(f"{noun}: {length:,} bytes unpacked; accepted: up to {most:,}")


def check_whole(path: Path, noun: str, length: int, factor: int = _MAX_WHOLE_FACTOR) -> None:
    """Refuse a file whose parts together would unpack to far more than its size."""
    check_length(
        f"its {noun} together", length, max(_MAX_WHOLE_BYTES, factor * path.stat().st_size)
    )


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file.

    Raises:
        DamagedError: if it is none, or its arrays would unpack to far more than its size.
    """
    with library_errors():
        with zipfile.ZipFile(path) as archive:
            length = sum(member.file_size for member in archive.infolist())
            check_whole(path, "arrays", length, ARRAYS_FACTOR)
        with np.errstate(invalid="ignore"), np.load(path, allow_pickle=False) as content:
            return {
                name: values for name, values in content.items() if isinstance(values, np.ndarray)
            }


def unpack_file(source: Path, target: Path) -> None:
    """Unpack a file that zstd has compressed as a whole.

    Raises:
        DamagedError: if it cannot be read, or unpacks to far more than its size.
        Rx90Error: if the target cannot be written.
    """
    done = 0
    with library_errors(), zstd.open(source, "rb") as content, target.open("wb") as whole:
        while block := content.read(_COPY_BYTES):
            done += len(block)
            check_whole(source, "content, as far as it was unpacked,", done)
            try:
                whole.write(block)
            except OSError as error:
                raise write_error(target, error) from error


def unpack_message(content: bytes) -> bytes:
    """Return a message that is compressed."""
    frame = zstd.ZstdDecompressor()
    with library_errors("a compressed message: "):
        data = frame.decompress(content, MAX_MESSAGE_BYTES)
    if not frame.eof:
        raise DamagedError(
            f"a compressed message is cut off, or longer than {MAX_MESSAGE_BYTES:,} bytes"
        )
    return data
