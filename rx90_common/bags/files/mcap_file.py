"""An mcap file: each message is read where it stands, and the indexes by which others find it must lead there."""

from __future__ import annotations

import mmap
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.files.compression import ZSTD_MAGIC, ZSTD_MESSAGES, decompress_chunk, decompress_message
from rx90_common.bags.files.contents import DamagedError, FileTopic, full_type
from rx90_common.bags.files.mcap_records import HEAD_BYTES, Op, walk
from rx90_common.bags.files.mcap_structure import (
    Block,
    check_data_crc,
    check_statistics,
    check_summary,
    read_structure,
)

_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
_HEAD_BYTES = _HEAD.itemsize  # of a message, with that of its record
_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
_LATEST_NS = (1 << 63) - 1

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
            statistics = check_summary(self._data, self._structure)
            counts = self._counts()
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
            channels = self._heads(block)[1]["channel"].tolist()
            block.count = len(channels)
            counts.update(channels)
        return counts

    def _topics(self, counts: Counter[int]) -> list[FileTopic]:
        dictionary = self._structure.dictionary
        return [
            FileTopic(key, channel.topic, full_type(dictionary.type_of(channel)), channel.encoding, counts[key])
            for key, channel in sorted(dictionary.channels.items())
        ]

    def _concerns(self, block: Block, keys: Collection[int]) -> bool:
        return not (self._structure.trusted and block.index) or any(part.channel in keys for part in block.index)

    def _read(self, block: Block, wanted: NDArray[np.int64]) -> list[_Message]:
        content, heads, starts = self._heads(block)
        rows = np.flatnonzero(np.isin(heads["channel"], wanted))
        heads, starts = heads[rows], starts[rows]
        ends = starts + HEAD_BYTES + heads["length"].astype(np.int64)
        columns: Any = (heads["channel"], heads["log"], starts + _HEAD_BYTES, ends)
        rows_of_columns = zip(*(column.tolist() for column in columns), strict=True)
        messages = [(key, log, content[start:end]) for key, log, start, end in rows_of_columns]
        if ZSTD_MAGIC in content and any(data.startswith(ZSTD_MAGIC) for _, _, data in messages):
            self.compression = ZSTD_MESSAGES
            messages = [(key, log, decompress_message(data)) for key, log, data in messages]
        return messages

    def _heads(self, block: Block) -> tuple[bytes, Any, NDArray[np.int64]]:
        """Return what is in a block, the heads of its messages, and where they begin, as they stand in it.

        Raises:
            DamagedError: if the content, its checksum, the index and the head of the chunk are not of one kind.
        """
        where = f"the chunk at byte {block.start}"
        content = self._data[slice(*block.content)]
        if block.compression is not None:
            content = decompress_chunk(where, content, block.compression, block.size, block.crc)
        index = self._index(block)
        starts = np.sort(index["offset"]) if block.index else self._offsets(content)
        if len(starts) and (starts[0] < 0 or starts[-1] > len(content) - _HEAD_BYTES):
            raise DamagedError(f"the index of {where} points behind its end")
        bytes_of_heads = np.frombuffer(content, dtype=np.uint8)[starts[:, np.newaxis] + np.arange(_HEAD_BYTES)]
        heads: Any = np.ascontiguousarray(bytes_of_heads).view(_HEAD)[:, 0] if len(starts) else np.zeros(0, _HEAD)
        self._check_content(where, content, heads, starts)
        self._check_times(where, block, heads)
        if block.index:
            _check_index(where, index, heads, starts)
        return content, heads, starts

    def _index(self, block: Block) -> Any:
        """Return the entries of a block's index with their channels."""
        parts = [np.frombuffer(self._data[part.start : part.end], dtype=_ENTRY) for part in block.index]
        index = np.zeros(sum(map(len, parts)), dtype=[("offset", "<i8"), ("channel", "<i8"), ("log", "<u8")])
        if parts:
            entries = np.concatenate(parts)
            index["offset"], index["log"] = entries["offset"].view(np.int64), entries["log"]
            index["channel"] = np.repeat([part.channel for part in block.index], [len(part) for part in parts])
        return index

    def _offsets(self, content: bytes) -> NDArray[np.int64]:
        starts = [place.start - HEAD_BYTES for place in walk(content, 0, len(content)) if place.op == Op.MESSAGE]
        return np.array(starts, dtype=np.int64)

    def _check_content(self, where: str, content: bytes, heads: Any, starts: NDArray[np.int64]) -> None:
        """Check that messages and other records fill the content, and take the schemas and channels among them."""
        if len(heads) and not ((heads["op"] == Op.MESSAGE) & (heads["length"] < len(content))).all():
            raise DamagedError(f"the index of {where} points to what is no message")
        ends = starts + HEAD_BYTES + heads["length"].astype(np.int64)
        gaps = np.stack([np.append(0, ends), np.append(starts, len(content))], axis=1)
        dictionary = self._structure.dictionary
        for start, end in gaps[gaps[:, 0] != gaps[:, 1]].tolist():
            if start > end:
                raise DamagedError(f"messages of {where} overlap")
            for place in walk(content, start, end):
                if place.op == Op.MESSAGE:
                    raise DamagedError(f"a message of {where} is not in its index")
                dictionary.add(place.op, content[place.start : place.end])
        for channel in np.unique(heads["channel"]).tolist():
            if channel not in dictionary.channels:
                raise DamagedError(f"messages of {where} are of channel {channel}, which is not there")

    def _check_times(self, where: str, block: Block, heads: Any) -> None:
        if not len(heads):
            return
        first, last = int(heads["log"].min()), int(heads["log"].max())
        if (first, last) != (block.first_ns, block.last_ns) or last > _LATEST_NS:
            raise DamagedError(f"the messages of {where} have other times than its head says")


def _check_index(where: str, index: Any, heads: Any, starts: NDArray[np.int64]) -> None:
    order = np.argsort(index["offset"], kind="stable")
    same = (index["channel"][order] == heads["channel"]) & (index["log"][order] == heads["log"])
    if not same.all() or len(np.unique(starts)) != len(starts):
        raise DamagedError(f"the index of {where} is not that of its messages")
