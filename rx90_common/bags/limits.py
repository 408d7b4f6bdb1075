"""What files may unpack to, checked before it is unpacked; and errors of the libraries that read them as one kind."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import lz4.frame
import numpy as np
from backports import zstd
from mcap.records import Chunk
from numpy.typing import NDArray

from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
MAX_RECORD_BYTES: Final = 32 << 20
MAX_MESSAGE_BYTES: Final = 16 << 20
_MAX_ARRAYS_BYTES = 256 << 20  # of all in a file, or
_MAX_ARRAYS_FACTOR = 50  # times its size


class DamagedError(Exception):
    """A file contradicts itself; the text names the place, and who opened the file prefixes its name."""


@contextmanager
def library_errors(where: str = "") -> Iterator[None]:
    """Make one DamagedError of whatever a library raises for bytes that it cannot read."""
    try:
        yield
    except (DamagedError, BagError):
        raise
    except Exception as error:  # the libraries have no common error
        text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        raise DamagedError(plain(where + text, 300)) from error


def check_length(noun: str, length: int, most: int) -> None:
    """Refuse what would unpack to more bytes than that, before it is unpacked."""
    if length > most:
        raise DamagedError(f"{noun}: {length:,} bytes unpacked; accepted: up to {most:,}")


def check_arrays(path: Path, length: int) -> None:
    """Refuse a file whose arrays would unpack to far more than its size."""
    check_length("its arrays together", length, max(_MAX_ARRAYS_BYTES, _MAX_ARRAYS_FACTOR * path.stat().st_size))


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file.

    Raises:
        DamagedError: if it is none, or its arrays would unpack to far more than its size.
    """
    with library_errors():
        with zipfile.ZipFile(path) as archive:
            check_arrays(path, sum(member.file_size for member in archive.infolist()))
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the content of a chunk of mcap that has the length and the checksum that its head states."""
    size = chunk.uncompressed_size
    check_length("a chunk", size, MAX_RECORD_BYTES)
    content = chunk.data
    if chunk.compression == "zstd":
        content = zstd.ZstdDecompressor().decompress(content, size + 1)
    elif chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameDecompressor().decompress(content, size + 1)
    elif chunk.compression:
        raise DamagedError(f"a chunk is compressed by {plain(chunk.compression)}; accepted: zstd, lz4")
    if len(content) != size:
        how = "longer" if len(content) > size else "shorter"
        raise DamagedError(f"a chunk is {how} than {size:,} bytes, which its head says")
    if chunk.uncompressed_crc not in (0, crc32(content)):
        raise DamagedError("the checksum of a chunk does not match")
    return content


def unpack_message(content: bytes) -> bytes:
    """Return a message that is compressed."""
    frame = zstd.ZstdDecompressor()
    with library_errors("a compressed message: "):
        data = frame.decompress(content, MAX_MESSAGE_BYTES)
    if not frame.eof:
        raise DamagedError(f"a compressed message is cut off, or longer than {MAX_MESSAGE_BYTES:,} bytes")
    return data
