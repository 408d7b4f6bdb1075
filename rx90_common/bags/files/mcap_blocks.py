"""What is in a chunk of an mcap file, or in messages without one, checked against the chunk's head and index."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.files.compression import decompress_chunk
from rx90_common.bags.files.contents import DamagedError
from rx90_common.bags.files.mcap_records import HEAD_BYTES, Dictionary, Op, walk
from rx90_common.bags.files.mcap_structure import McapBlock

MESSAGE_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""Before each message: the head of its record, and its own."""

_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
_LATEST_NS = (1 << 63) - 1


class BlockContent(NamedTuple):
    """What is in a block.

    Attributes:
        data: decompressed.
        heads: of its messages in the order in which they stand there, MESSAGE_HEAD, shape (n,).
        starts: where these begin, shape (n,).
    """

    data: bytes
    heads: Any
    starts: NDArray[np.int64]

    @property
    def ends(self) -> NDArray[np.int64]:
        """Return where its messages end, shape (n,)."""
        return np.asarray(self.starts + HEAD_BYTES + self.heads["length"].astype(np.int64))


class BlockReader:
    """Reads blocks.

    Args:
        data: of the file.
        dictionary: takes the schemas and channels in the blocks; all messages must be of its channels.
    """

    def __init__(self, data: bytes, dictionary: Dictionary) -> None:
        self._data = data
        self._dictionary = dictionary

    def read(self, block: McapBlock) -> BlockContent:
        """Return what is in a block.

        Raises:
            DamagedError: if the content, its checksum, the index and the head of the chunk do not fit together.
        """
        where = f"the chunk at byte {block.start}"
        data = self._data[slice(*block.content)]
        if block.compression is not None:
            data = decompress_chunk(where, data, block.compression, block.size, block.crc)
        index = self._index(block)
        starts = np.sort(index["offset"]) if block.index else _offsets(data)
        if len(starts) and (starts[0] < 0 or starts[-1] > len(data) - MESSAGE_HEAD.itemsize):
            raise DamagedError(f"the index of {where} points behind its end")
        bytes_of_heads = np.frombuffer(data, dtype=np.uint8)[starts[:, np.newaxis] + np.arange(MESSAGE_HEAD.itemsize)]
        heads = np.frombuffer(bytes_of_heads.tobytes(), dtype=MESSAGE_HEAD)
        if not ((heads["op"] == Op.MESSAGE) & (heads["length"] < len(data))).all():
            raise DamagedError(f"the index of {where} points to what is no message")
        content = BlockContent(data, heads, starts)
        self._take_others(where, content)
        if len(starts):
            self._check_channels(where, heads)
            _check_times(where, block, heads)
        if block.index:
            _check_index(where, index, content)
        return content

    def _index(self, block: McapBlock) -> Any:
        """Return the entries of a block's index with their channels."""
        parts = [np.frombuffer(self._data[part.start : part.end], dtype=_ENTRY) for part in block.index]
        index = np.zeros(sum(map(len, parts)), dtype=[("offset", "<i8"), ("channel", "<i8"), ("log", "<u8")])
        if parts:
            entries = np.concatenate(parts)
            index["offset"], index["log"] = entries["offset"].view(np.int64), entries["log"]
            index["channel"] = np.repeat([part.channel for part in block.index], [len(part) for part in parts])
        return index

    def _take_others(self, where: str, content: BlockContent) -> None:
        """Check that the messages and other records fill the block, and take the schemas and channels among these."""
        gaps = np.stack([np.append(0, content.ends), np.append(content.starts, len(content.data))], axis=1)
        for start, end in gaps[gaps[:, 0] != gaps[:, 1]].tolist():
            if start > end:
                raise DamagedError(f"messages of {where} overlap")
            for place in walk(content.data, start, end):
                if place.op == Op.MESSAGE:
                    raise DamagedError(f"a message of {where} is not in its index")
                self._dictionary.add(place.op, content.data[place.start : place.end])

    def _check_channels(self, where: str, heads: Any) -> None:
        for channel in np.unique(heads["channel"]).tolist():
            if channel not in self._dictionary.channels:
                raise DamagedError(f"messages of {where} are of channel {channel}, which is not there")


def _offsets(data: bytes) -> NDArray[np.int64]:
    starts = [place.start - HEAD_BYTES for place in walk(data, 0, len(data)) if place.op == Op.MESSAGE]
    return np.array(starts, dtype=np.int64)


def _check_times(where: str, block: McapBlock, heads: Any) -> None:
    first, last = int(heads["log"].min()), int(heads["log"].max())
    if (first, last) != (block.first_ns, block.last_ns) or last > _LATEST_NS:
        raise DamagedError(f"the messages of {where} have other times than its head says")


def _check_index(where: str, index: Any, content: BlockContent) -> None:
    order = np.argsort(index["offset"], kind="stable")
    heads = content.heads
    same = (index["channel"][order] == heads["channel"]) & (index["log"][order] == heads["log"])
    if not same.all() or len(np.unique(content.starts)) != len(content.starts):
        raise DamagedError(f"the index of {where} is not that of its messages")
