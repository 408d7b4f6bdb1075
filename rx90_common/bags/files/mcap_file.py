"""An mcap file: each message is read where it stands, and the indexes by which others find it must lead there."""

from __future__ import annotations

import mmap
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.files.compression import ZSTD_MAGIC, ZSTD_MESSAGES, decompress_message
from rx90_common.bags.files.contents import FileTopic, full_type
from rx90_common.bags.files.mcap_blocks import MESSAGE_HEAD, BlockReader
from rx90_common.bags.files.mcap_structure import (
    McapBlock,
    check_channels,
    check_data_crc,
    check_statistics,
    check_summary,
    read_structure,
)

_Message = tuple[int, int, bytes]


class McapFile:
    """An mcap file that is open.

    Args:
        path: of the file.

    Raises:
        DamagedError: if its records or its summary contradict each other.
    """

    kind = "mcap"

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            self._map = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        try:
            # A map gives bytes for each slice of it; that is all that is asked of it here.
            self._data = cast("bytes", self._map)
            self._structure = read_structure(self._data)
            self._blocks = BlockReader(self._data, self._structure.dictionary)
            statistics = check_summary(self._data, self._structure)
            counts = self._counts()
            check_channels(self._structure, counts)
            if statistics is not None:
                check_statistics(self._data, statistics, self._structure, counts)
            self.topics = self._topics(counts)
        except BaseException:
            self._map.close()
            raise
        kinds = {block.compression for block in self._structure.blocks} - {"", None}
        self.compression = ", ".join(f"{kind} chunks" for kind in sorted(map(str, kinds)))

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def messages(self, keys: Collection[int]) -> Iterator[_Message]:
        """Yield (channel, log time in ns, message) in the order of log time, equal times as they stand in the file.

        All chunks are read and checked; those without a wanted channel are not, where a checksum vouches for the index.

        Raises:
            DamagedError: see `StorageFile`.
        """
        wanted = np.array(sorted(keys), dtype=np.int64)
        blocks = [block for block in self._structure.blocks if self._concerns(block, keys)]
        if len(blocks) == len(self._structure.blocks):
            check_data_crc(self._data, self._structure)
        blocks.sort(key=lambda block: block.first_ns)
        pending: list[_Message] = []
        for i, block in enumerate(blocks):
            pending += self._read(block, wanted)
            pending.sort(key=itemgetter(1))
            # What is earlier than all that follows.
            end = bisect_left(pending, blocks[i + 1].first_ns, key=itemgetter(1)) if i + 1 < len(blocks) else None
            yield from pending[:end]
            pending = [] if end is None else pending[end:]

    def _counts(self) -> Counter[int]:
        """Return the number of messages by channel.

        Where an index or the summary does not tell, chunks are looked into, in their order: for what they announce.
        """
        blocks, known = self._structure.blocks, self._structure.dictionary.channels
        counts: Counter[int] = Counter()
        for block in blocks:
            block.count = sum(part.messages for part in block.index)
            for part in block.index:
                counts[part.channel] += part.messages
        if all(block.index for block in blocks) and all(channel in known for channel in counts):
            return counts
        counts.clear()
        for block in blocks:
            channels = self._blocks.read(block).heads["channel"].tolist()
            block.count = len(channels)
            counts.update(channels)
        return counts

    def _topics(self, counts: Counter[int]) -> list[FileTopic]:
        dictionary = self._structure.dictionary
        return [
            FileTopic(key, channel.topic, full_type(dictionary.type_of(channel)), channel.encoding, counts[key])
            for key, channel in sorted(dictionary.channels.items())
        ]

    def _concerns(self, block: McapBlock, keys: Collection[int]) -> bool:
        return not (self._structure.trusted and block.index) or any(part.channel in keys for part in block.index)

    def _read(self, block: McapBlock, wanted: NDArray[np.int64]) -> list[_Message]:
        content = self._blocks.read(block)
        rows = np.flatnonzero(np.isin(content.heads["channel"], wanted))
        heads = content.heads[rows]
        columns = (heads["channel"], heads["log"], content.starts[rows] + MESSAGE_HEAD.itemsize, content.ends[rows])
        rows_of_columns = zip(*(column.tolist() for column in columns), strict=True)
        messages = [(key, log, content.data[start:end]) for key, log, start, end in rows_of_columns]
        if ZSTD_MAGIC in content.data and any(data.startswith(ZSTD_MAGIC) for _, _, data in messages):
            self.compression = ZSTD_MESSAGES
            messages = [(key, log, decompress_message(data)) for key, log, data in messages]
        return messages
