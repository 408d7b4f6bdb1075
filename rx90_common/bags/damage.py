"""Explain in one line why a bag cannot be read, and what can be recovered from it."""

from __future__ import annotations

import struct
from pathlib import Path

from rx90_common.base.rates import NANOSECONDS

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_CHUNK, _MESSAGE_INDEX, _DATA_END = 0x06, 0x07, 0x0F
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = 6, 16
_SUFFIXES = (".mcap", ".db3")


def explain(path: Path, error: Exception) -> str:
    """Return the line for a bag at `path` which rosbags could not read because of `error`."""
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
        if not files:
            return (
                f"{path}: not a bag, or an emptied one: no .mcap or .db3 file in it; "
                "accepted: a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file"
            )
        if not (path / "metadata.yaml").exists():
            return f"{path}: metadata.yaml is missing; {_what_remains(files[-1])}"
        broken = [file for file in files if file.suffix == ".mcap" and not _is_closed(file)]
        if broken:
            return f"{path}: {_what_remains(broken[0])}"
    elif path.suffix == ".mcap" and not _is_closed(path):
        return f"{path}: {_what_remains(path)}"
    return f"{path}: damaged or not a bag ({_one_line(error)})"


def unfinished(path: Path) -> str | None:
    """Return the line for a sqlite3 file that still has its journal: reading would show a torn state."""
    files = sorted(path.glob("*.db3")) if path.is_dir() else [path]
    torn = [file for file in files if file.suffix == ".db3" and Path(f"{file}-journal").exists()]
    if not torn:
        return None
    return f"{path}: {torn[0].name} was not closed (its recorder was killed?); {_what_remains(torn[0])}"


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


def _what_remains(file: Path) -> str:
    """Return what can be done with a storage file whose recorder did not end well."""
    if file.suffix == ".db3":
        return (
            f"sqlite3 restores {file.name} up to its last commit when it is opened for writing, "
            "and 'ros2 bag reindex' then writes the metadata"
        )
    if _is_closed(file):
        return f"{file.name} is whole: give its path instead, or let 'ros2 bag reindex' write the metadata"
    count, end_ns = _count_whole_chunks(file)
    if not count:
        return f"{file.name} is cut off before its first whole chunk: nothing can be recovered"
    return (
        f"{file.name} is cut off (its recorder was killed?): {count} messages up to t = {end_ns / NANOSECONDS:.6f} s "
        "are whole, 'mcap recover' restores them"
    )


def _is_closed(file: Path) -> bool:
    """Return whether an mcap file has both its first and its last bytes."""
    try:
        with file.open("rb") as stream:
            if stream.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
                return True  # not cut off but foreign
            stream.seek(-len(_MCAP_MAGIC), 2)
            return stream.tell() > 0 and stream.read() == _MCAP_MAGIC
    except OSError:
        return True


def _count_whole_chunks(file: Path) -> tuple[int, int]:
    """Return how many messages the indexed chunks of a cut mcap file hold, and the last log time in ns."""
    size = file.stat().st_size
    count = end_ns = 0
    with file.open("rb") as stream:
        stream.seek(len(_MCAP_MAGIC))
        while len(head := stream.read(9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            after = stream.tell() + length
            if after > size or opcode == _DATA_END:
                break
            if opcode == _CHUNK and length >= 16:
                end_ns = max(end_ns, struct.unpack("<QQ", stream.read(16))[1])
            elif opcode == _MESSAGE_INDEX:
                count += (length - _INDEX_HEAD_BYTES) // _INDEX_ENTRY_BYTES
            stream.seek(after)
    return count, end_ns
