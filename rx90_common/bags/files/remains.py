"""Recognise a storage file whose recorder did not end well, and say what can be recovered from it."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

from rx90_common.bags.files.mcap_records import HEAD_BYTES, MAGIC, Op
from rx90_common.base.rates import NANOSECONDS

_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = 6, 16
_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")


def unfinished(file: Path) -> str | None:
    """Return what is wrong with a file that was not closed, and what remains of it; None for any other file.

    A database with a journal or a write-ahead log was not closed: reading it alone would show a torn state.
    """
    for suffix in ("-journal", "-wal"):
        with suppress(OSError):  # there is none, or its name would be too long to be one
            if Path(f"{file}{suffix}").stat().st_size:
                return (
                    f"was not closed (its recorder was killed?); sqlite3 restores {file.name} up to its last commit "
                    "when it is opened for writing, and 'ros2 bag reindex' then writes the metadata"
                )
    if not _is_cut_off(file):
        return None
    count, end_ns = _count_whole_chunks(file)
    if not count:
        return "is cut off before its first whole chunk: nothing can be recovered"
    return (
        f"is cut off (its recorder was killed, or the disk was full?): {count} messages up to t = "
        f"{end_ns / NANOSECONDS:.6f} s are whole, 'mcap recover' restores them"
    )


def _is_cut_off(file: Path) -> bool:
    """Return whether a file has the first bytes of an mcap file, and not the last ones."""
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return False
        stream.seek(-len(MAGIC), 2)
        return stream.tell() == 0 or stream.read() != MAGIC


def _count_whole_chunks(file: Path) -> tuple[int, int]:
    """Return how many messages the indexed chunks of a cut mcap file hold, and the last log time in ns."""
    size = file.stat().st_size
    count = end_ns = 0
    with file.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(head := stream.read(HEAD_BYTES)) == HEAD_BYTES:
            op, length = _HEAD.unpack(head)
            after = stream.tell() + length
            if after > size or op == Op.DATA_END:
                break
            if op == Op.CHUNK and length >= _TIMES.size:
                end_ns = max(end_ns, _TIMES.unpack(stream.read(_TIMES.size))[1])
            elif op == Op.MESSAGE_INDEX:
                count += (length - _INDEX_HEAD_BYTES) // _INDEX_ENTRY_BYTES
            stream.seek(after)
    return count, end_ns
