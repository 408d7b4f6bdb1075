"""What bags are compressed with: zstd and lz4, in chunks, messages or whole files."""

from __future__ import annotations

import shutil
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import lz4.frame

from rx90_common.bags.files.contents import DamagedError
from rx90_common.base.errors import write_error
from rx90_common.base.quoting import quoted

if sys.version_info >= (3, 14):
    from compression import zstd
else:  # rosbags brings it
    from backports import zstd

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
ZSTD_MESSAGES: Final = "zstd messages"

_MOST_BYTES = 256 << 20  # of a message; nothing beside it says how long it is
_STEP = 1 << 20
_CHUNKS: dict[str, Callable[[], Any]] = {"zstd": zstd.ZstdDecompressor, "lz4": lz4.frame.LZ4FrameDecompressor}


def decompress_chunk(where: str, content: bytes, compression: str, size: int, crc: int) -> bytes:
    """Return what is in a chunk.

    Raises:
        DamagedError: if it cannot be decompressed, or has another size or checksum.
    """
    if compression not in ("", *_CHUNKS):
        raise DamagedError(f"{where} is compressed as {quoted(compression)}; accepted: {', '.join(_CHUNKS)}")
    try:
        data = _decompress(_CHUNKS[compression], content, size) if compression else content
    except Exception as error:  # of zstd and lz4, which have no root in common
        raise DamagedError(f"{where}: {str(error) or type(error).__name__}") from error
    if len(data) != size:
        raise DamagedError(f"{where} has {len(data):,} bytes, not the {size:,} that its head says")
    if crc and zlib.crc32(data) != crc:
        raise DamagedError(f"the checksum of {where} is another one")
    return data


def decompress_message(content: bytes) -> bytes:
    """Return a message; one that is compressed begins as no CDR message does.

    Raises:
        DamagedError: if it cannot be decompressed.
    """
    if not content.startswith(ZSTD_MAGIC):
        return content
    try:
        return _decompress(zstd.ZstdDecompressor, content, _MOST_BYTES)
    except (zstd.ZstdError, EOFError) as error:
        raise DamagedError(f"a compressed message: {error}") from error


def _decompress(decompressor: Callable[[], Any], content: bytes, most: int) -> bytes:
    """Return what is in the frames of `content`; a few bytes may stand for more than a memory holds.

    Raises:
        EOFError: if it is more than `most` bytes, or cut off.
    """
    parts: list[bytes] = []
    length = 0
    while content:
        frame = decompressor()
        while not frame.eof:
            part = frame.decompress(content, _STEP)
            content = b""
            length += len(part)
            if length > most:
                raise EOFError(f"is longer than {most:,} bytes")
            if not part and not frame.eof:
                raise EOFError("is cut off")
            parts.append(part)
        content = frame.unused_data or b""
    return b"".join(parts)


def decompress_file(source: Path, target: Path) -> None:
    """Write what is in a compressed file to another one.

    Raises:
        DamagedError: if it cannot be decompressed, is cut off or has another checksum.
        Rx90Error: if there is no room for it.
    """
    with source.open("rb") as raw, zstd.open(raw, "rb") as content:
        try:
            with target.open("wb") as stream:
                shutil.copyfileobj(content, stream, 1 << 20)
        except (zstd.ZstdError, EOFError) as error:
            raise DamagedError(f"{error}") from error
        except OSError as error:
            raise write_error(target, error) from error
