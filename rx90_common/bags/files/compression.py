"""What bags are compressed with: zstd and lz4, in chunks, messages or whole files."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Final

from rosbags.rosbag2.storage_mcap import decompress

from rx90_common.bags.files.contents import DamagedError
from rx90_common.base.errors import write_error

if sys.version_info >= (3, 14):
    from compression import zstd
else:  # rosbags brings it
    from backports import zstd

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
ZSTD_MESSAGES: Final = "zstd messages"


def decompress_chunk(where: str, content: bytes, compression: str, size: int, crc: int) -> bytes:
    """Return what is in a chunk.

    Raises:
        DamagedError: if it cannot be decompressed, or has another size or checksum.
    """
    try:
        return decompress(content, compression, size, crc)
    except Exception as error:  # of zstd, lz4 and rosbags, which have no root in common
        raise DamagedError(f"{where}: {error or type(error).__name__}") from error


def decompress_message(content: bytes) -> bytes:
    """Return a message; one that is compressed begins as no CDR message does.

    Raises:
        DamagedError: if it cannot be decompressed.
    """
    if not content.startswith(ZSTD_MAGIC):
        return content
    try:
        return zstd.decompress(content)
    except (zstd.ZstdError, EOFError) as error:
        raise DamagedError(f"a compressed message: {error}") from error


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
