"""Open a storage file by what it begins with, whatever it is called."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from rx90_common.bags.files.compression import ZSTD_MAGIC, decompress_file
from rx90_common.bags.files.contents import StorageFile
from rx90_common.bags.files.mcap_file import McapFile
from rx90_common.bags.files.mcap_records import MAGIC
from rx90_common.bags.files.remains import unfinished
from rx90_common.bags.files.ros1_file import Ros1File
from rx90_common.bags.files.sqlite_file import SqliteFile
from rx90_common.base.errors import BagError

ACCEPTED = "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd"

_BEGINNINGS = ((MAGIC, McapFile), (b"SQLite format 3\0", SqliteFile), (b"#ROSBAG V2.0\n", Ros1File))
_LONGEST = max(len(beginning) for beginning, _ in _BEGINNINGS)


def open_file(path: Path, stack: ExitStack) -> StorageFile:
    """Open a storage file; one that is compressed is decompressed to a temporary file first.

    Args:
        path: of the file.
        stack: closes it.

    Raises:
        BagError: if it is no storage file, or was not closed.
        DamagedError: if it contradicts itself.
        Rx90Error: if there is no room to decompress it.
    """
    reason = unfinished(path)
    if reason is not None:
        raise BagError(reason)
    with path.open("rb") as stream:
        beginning = stream.read(_LONGEST)
    if not beginning:
        raise BagError("is empty")
    if beginning.startswith(ZSTD_MAGIC):
        target = Path(stack.enter_context(TemporaryDirectory(prefix="rx90_bag_"))) / path.stem
        decompress_file(path, target)
        inner = open_file(target, stack)
        inner.compression = "zstd files"
        return inner
    for known, kind in _BEGINNINGS:
        if beginning.startswith(known):
            file: StorageFile = kind(path)
            stack.callback(file.close)
            return file
    raise BagError(f"is no bag, or damaged at its beginning; accepted: {ACCEPTED}")
