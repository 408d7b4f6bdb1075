"""What files may unpack to, checked before it is unpacked; and errors of the libraries that read them as one kind."""

from __future__ import annotations

import math
import struct
import zipfile
from bz2 import BZ2Decompressor
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

from rx90_common.base.errors import BagError, write_error
from rx90_common.base.quoting import plain

MAX_CHUNK_BYTES: Final = 32 << 20
MAX_MESSAGE_BYTES: Final = 16 << 20
ROS1_MAGIC: Final = b"#ROSBAG V2.0\n"
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
_MAX_ARRAYS_BYTES = 256 << 20  # of all in a file, also of a bag that is compressed as a whole, or
_MAX_ARRAYS_FACTOR = 50  # times its size
_LONGEST_SIDE = (1 << 31) - 1  # of an array, also of one that holds nothing
_ARRAY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0}  # later versions begin alike
_COPY_BYTES = 1 << 20
_ROS1_CHUNK = b"\x05"  # op code
_ROS1_COMPRESSIONS = {b"bz2": BZ2Decompressor, b"lz4": lz4.frame.LZ4FrameDecompressor}
_LENGTH = struct.Struct("<I")


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


def check_whole(path: Path, noun: str, length: int) -> None:
    """Refuse a file whose parts together would unpack to far more than its size."""
    check_length(f"its {noun} together", length, max(_MAX_ARRAYS_BYTES, _MAX_ARRAYS_FACTOR * path.stat().st_size))


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file.

    Raises:
        DamagedError: if it is none, or its arrays would unpack to far more than its size.
    """
    with library_errors(), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        check_whole(path, "arrays", sum(member.file_size for member in members))
        arrays = {}
        for member in members:
            _check_header(archive, member)
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = np.lib.format.read_array(stream, allow_pickle=False)
        return arrays


def _check_header(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Refuse an array whose header asks for more or less than what follows it, before its memory is asked for."""
    with archive.open(member) as stream:
        read = _ARRAY_HEADERS.get(np.lib.format.read_magic(stream), np.lib.format.read_array_header_2_0)
        shape, _, kind = read(stream)
        length = member.file_size - stream.tell()
    stated = kind.itemsize * math.prod(shape)
    if stated != length or not all(0 <= count <= _LONGEST_SIDE for count in shape):
        shown = " x ".join(map(str, shape))
        raise DamagedError(plain(f"{member.filename} holds {length:,} bytes; its header says {shown} of {kind}"))


def unpack_file(source: Path, target: Path) -> None:
    """Unpack a file that zstd has compressed as a whole.

    Raises:
        DamagedError: if it cannot be read, or unpacks to far more than its size.
        Rx90Error: if the target cannot be written.
    """
    most = max(_MAX_ARRAYS_BYTES, _MAX_ARRAYS_FACTOR * source.stat().st_size)
    done = 0
    with library_errors(), zstd.open(source, "rb") as content, target.open("wb") as whole:
        while block := content.read(_COPY_BYTES):
            done += len(block)
            check_length("the whole, as far as it was unpacked", done, most)
            try:
                whole.write(block)
            except OSError as error:
                raise write_error(target, error) from error


def check_ros1_chunks(path: Path) -> None:
    """Refuse a bag of ROS 1 with a chunk that unpacks to too much, or to another length than its head says.

    rosbags unpacks a chunk whole, whatever comes of it. What stands beside chunks, and cut off files, are left to it.

    Raises:
        DamagedError: if there is one.
    """
    data = np.memmap(path, np.uint8, "r").data
    at = len(ROS1_MAGIC)
    whole = 0
    while at + _LENGTH.size <= len(data):
        fields, begin = _ros1_part(data, at)
        content, at = _ros1_part(data, begin)
        values = _ros1_fields(fields)
        if not values:
            return
        if values.get("op") == _ROS1_CHUNK:
            with library_errors(f"the chunk at byte {begin}: "):
                whole += _ros1_chunk_size(values, content)
            check_whole(path, "chunks", whole)


def _ros1_part(data: memoryview, at: int) -> tuple[memoryview, int]:
    """Return what stands behind its length, as far as the file goes, and where the next part begins."""
    begin = at + _LENGTH.size
    length = int.from_bytes(data[at:begin], "little")
    return data[begin : begin + length], begin + length


def _ros1_fields(part: memoryview) -> dict[str, bytes]:
    values = {}
    at = 0
    while at < len(part):
        field, at = _ros1_part(part, at)
        name, _, value = field.tobytes().partition(b"=")
        values[name.decode("latin-1")] = value
    return values


def _ros1_chunk_size(values: dict[str, bytes], content: memoryview) -> int:
    size = int.from_bytes(values.get("size", b""), "little")
    check_length("its content", max(size, len(content)), MAX_CHUNK_BYTES)
    kind: Any = _ROS1_COMPRESSIONS.get(values.get("compression", b""))
    if len(content if kind is None else kind().decompress(content.tobytes(), size + 1)) != size:
        raise DamagedError(f"unpacks to another length than {size:,} bytes, which its head says")
    return size


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the content of a chunk of mcap that has the length and the checksum that its head states."""
    size = chunk.uncompressed_size
    check_length("a chunk", size, MAX_CHUNK_BYTES)
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
