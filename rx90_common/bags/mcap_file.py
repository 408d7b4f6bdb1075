"""An mcap file, read by the library of the mcap project, and held against its own index and checksums.

The library's loop over messages takes some 3 us for each of them, so those of a chunk are found by compiled code; where
no index leads to chunks the library reads the file through.
"""

from __future__ import annotations

import mmap
import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import IO, Final, cast
from zlib import crc32

import lz4.frame
import numpy as np
from backports import zstd
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.storage_files import (
    ZSTD_MAGIC,
    DamagedError,
    FileTopic,
    LoggedMessage,
    decompressed,
    full_type,
    library_errors,
)
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.kernels.compiled import c_function

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"

_FOOTER = struct.Struct("<QQI")
_RECORD_HEAD: Final = 9  # op code and length
_MESSAGE_HEAD: Final = 22  # channel, sequence number, log time, time of publication
_INDEX_HEAD = struct.Struct("<BQHI")  # op code and length, channel, bytes of the entries
_MESSAGE: Final = 5  # op code


class McapFile:
    """An mcap file that is open.

    Args:
        path: of the file.

    Raises:
        DamagedError: if its summary cannot be read, or contradicts itself.
    """

    kind = "mcap"

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        self._chunks: list[ChunkIndex] = []
        self._messages: list[LoggedMessage] = []  # where there is no index
        try:
            with library_errors():
                summary = self._summary()
                if not _leads_to_all(summary):
                    summary = self._read_through(summary)
                self._chunks = summary.chunk_indexes
                self.topics = _topics(summary)
        except BaseException:
            self._data.close()
            raise
        self.compression = ", ".join(
            f"{kind} chunks" for kind in sorted({chunk.compression for chunk in self._chunks} - {""})
        )

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these channels in the order of log time, equal times as they stand in the file.

        Raises:
            DamagedError: if a chunk, its checksum, its index and that of the file do not fit together.
        """
        yield from (message for message in self._messages if message[0] in keys)
        wanted = np.array(sorted(keys), dtype=np.int64)
        chunks = [chunk for chunk in self._chunks if _may_hold(chunk, keys)]
        chunks.sort(key=lambda chunk: chunk.message_start_time)
        pending: list[LoggedMessage] = []
        for i, chunk in enumerate(chunks):
            with library_errors(f"the chunk at byte {chunk.chunk_start_offset}: "):
                pending += self._read_chunk(chunk, wanted)
            pending.sort(key=itemgetter(1))
            # What is earlier than all that follows.
            following = chunks[i + 1].message_start_time if i + 1 < len(chunks) else None
            end = None if following is None else bisect_left(pending, following, key=itemgetter(1))
            yield from pending[:end]
            pending = [] if end is None else pending[end:]

    def _summary(self) -> Summary:
        """Return the summary, whose checksum the library does not look at; an empty one where there is none."""
        start, _, crc = _FOOTER.unpack(self._data[-_FOOTER.size - len(MCAP_MAGIC) : -len(MCAP_MAGIC)])
        if start and crc and crc != crc32(self._data[start : -4 - len(MCAP_MAGIC)]):
            raise DamagedError("the checksum of its summary does not match")
        self._data.seek(0)
        return SeekingReader(cast("IO[bytes]", self._data)).get_summary() or Summary()

    def _read_through(self, listed: Summary) -> Summary:
        """Read all messages into memory; return the summary of a file whose own leads to none of them."""
        found, counts = Summary(), Counter[int]()
        self._data.seek(0)
        for record in self._records():
            if isinstance(record, Schema):
                found.schemas[record.id] = record
            elif isinstance(record, Channel):
                found.channels[record.id] = record
            elif isinstance(record, Message):
                self._messages.append((record.channel_id, record.log_time, decompressed(record.data)))
        self._messages.sort(key=itemgetter(1))
        counts.update(key for key, _, _ in self._messages)
        if listed.statistics is not None and listed.statistics.message_count != counts.total():
            total = listed.statistics.message_count
            raise DamagedError(f"its statistics say {total:,} messages, there are {counts.total():,}")
        for channel in counts:
            if channel not in (listed.channels or found.channels):
                raise DamagedError(f"its summary lacks channel {channel}, which has messages")
        found.statistics = Statistics(0, 0, dict(counts), 0, 0, 0, 0, 0, 0)
        return found

    def _records(self) -> Iterator[McapRecord]:
        for record in StreamReader(cast("IO[bytes]", self._data), validate_crcs=True, emit_chunks=True).records:
            if isinstance(record, Chunk):
                yield from breakup_chunk(replace(record, compression="", data=_content(record)))
            else:
                yield record

    def _read_chunk(self, listed: ChunkIndex, wanted: Int64Array) -> list[LoggedMessage]:
        """Return messages of a chunk, which is held against its checksum, its head and both indexes."""
        start, end = listed.chunk_start_offset, listed.chunk_start_offset + listed.chunk_length
        self._data.seek(start)
        if self._data.read(_RECORD_HEAD) != struct.pack("<BQ", Opcode.CHUNK, listed.chunk_length - _RECORD_HEAD):
            raise DamagedError("its index is not that of its chunks")
        chunk = Chunk.read(ReadDataStream(cast("IO[bytes]", self._data)))
        if self._data.tell() != end:
            raise DamagedError("its index is not that of its chunks")
        content = _content(chunk)
        rows = messages_in(content)
        _check_index(listed, chunk, rows, self._data[end : end + listed.message_index_length])
        if not listed.message_index_offsets or not np.isin(list(listed.message_index_offsets), wanted).all():
            rows = rows[np.isin(rows[:, 0], wanted)]
        messages = [
            (channel, log_ns, content[begin:end]) for channel, log_ns, begin, end in rows[:, [0, 1, 3, 4]].tolist()
        ]
        if ZSTD_MAGIC in content and any(data.startswith(ZSTD_MAGIC) for _, _, data in messages):
            self.compression = "zstd messages"
            messages = [(channel, log_ns, decompressed(data)) for channel, log_ns, data in messages]
        return messages


def _content(chunk: Chunk) -> bytes:
    """Return what a chunk holds; unlike the library, without decompressing more than its head says.

    Raises:
        DamagedError: if length or checksum are not those of its head.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        data = zstd.ZstdDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise DamagedError(f"a chunk is compressed by {plain(chunk.compression)}; accepted: zstd, lz4")
    if len(data) != size:
        how = "longer" if len(data) > size else "shorter"
        raise DamagedError(f"a chunk is {how} than {size:,} bytes, which its head says")
    if chunk.uncompressed_crc and chunk.uncompressed_crc != crc32(data):
        raise DamagedError("the checksum of a chunk does not match")
    return data


def _leads_to_all(summary: Summary) -> bool:
    """Return whether a summary counts the messages of each channel and lists chunks with them.

    Raises:
        DamagedError: if it lists another number of chunks, or lacks a channel.
    """
    statistics = summary.statistics
    if statistics is None or sum(statistics.channel_message_counts.values()) != statistics.message_count:
        return False
    if summary.chunk_indexes and statistics.chunk_count != len(summary.chunk_indexes):
        raise DamagedError(
            f"its statistics say {statistics.chunk_count:,} chunks, {len(summary.chunk_indexes):,} are listed"
        )
    for channel, count in statistics.channel_message_counts.items():
        if count and summary.channels and channel not in summary.channels:
            raise DamagedError(f"its summary lacks channel {channel}, which has messages")
    return bool(summary.channels) and (bool(summary.chunk_indexes) or not statistics.message_count)


def _topics(summary: Summary) -> list[FileTopic]:
    counts = summary.statistics.channel_message_counts if summary.statistics is not None else {}
    for channel in summary.channels.values():
        if channel.schema_id and channel.schema_id not in summary.schemas:
            raise DamagedError(f"{plain(channel.topic)} is of schema {channel.schema_id}, which is not there")
    return [
        FileTopic(
            key,
            channel.topic,
            full_type(summary.schemas[channel.schema_id].name if channel.schema_id else ""),
            channel.message_encoding,
            counts.get(key, 0),
        )
        for key, channel in sorted(summary.channels.items())
    ]


def _may_hold(chunk: ChunkIndex, channels: Collection[int]) -> bool:
    return not chunk.message_index_offsets or any(key in channels for key in chunk.message_index_offsets)


@c_function(types.int64(types.voidptr, types.int64, types.voidptr))
def _find_messages(data_at, size, rows_at):  # type: ignore[no-untyped-def]  # addresses
    """Write channel, log time, place of the record, begin and end of each message; return how many, -1 for others."""
    data = carray(data_at, (size,), np.uint8)
    rows = carray(rows_at, (size // (_RECORD_HEAD + _MESSAGE_HEAD), 5), np.int64)
    count = at = 0
    while at < size:
        if size - at < _RECORD_HEAD:
            return -1
        begin = at + _RECORD_HEAD
        length = np.int64(0)
        for k in range(8):
            length |= np.int64(data[at + 1 + k]) << (8 * k)
        if length < 0 or length > size - begin:
            return -1
        if data[at] == _MESSAGE:
            if length < _MESSAGE_HEAD:
                return -1
            log_ns = np.int64(0)
            for k in range(8):
                log_ns |= np.int64(data[begin + 6 + k]) << (8 * k)
            rows[count, 0] = np.int64(data[begin]) | np.int64(data[begin + 1]) << 8
            rows[count, 1], rows[count, 2] = log_ns, at
            rows[count, 3], rows[count, 4] = begin + _MESSAGE_HEAD, begin + length
            count += 1
        at = int(begin + length)
    return count


def messages_in(content: bytes) -> Int64Array:
    """Return channel, log time, place of the record, begin and end of each message in a chunk, shape (n, 5).

    Raises:
        DamagedError: if records do not fill the chunk.
    """
    data = np.frombuffer(content, dtype=np.uint8)
    rows = np.empty((len(data) // (_RECORD_HEAD + _MESSAGE_HEAD), 5), dtype=np.int64)
    count = _find_messages(data.ctypes.data, len(data), rows.ctypes.data)
    if count < 0:
        raise DamagedError("its records do not fill it")
    return rows[:count]


def _check_index(listed: ChunkIndex, chunk: Chunk, rows: Int64Array, section: bytes) -> None:
    """Hold what was found in a chunk against its head, the index behind it and the file's index.

    Raises:
        DamagedError: if one would lead another reader to other messages.
    """
    head = (
        chunk.message_start_time,
        chunk.message_end_time,
        chunk.compression,
        len(chunk.data),
        chunk.uncompressed_size,
    )
    if head != (
        listed.message_start_time, listed.message_end_time, listed.compression, listed.compressed_size,
        listed.uncompressed_size,
    ):  # fmt: skip
        raise DamagedError("its index is not that of its chunks")
    where = f"the chunk at byte {listed.chunk_start_offset}"
    if len(rows) and (int(rows[:, 1].min()), int(rows[:, 1].max())) != head[:2]:
        raise DamagedError(f"the messages of {where} have other times than its head says")
    places: dict[int, int] = {}
    entries = [np.zeros((0, 3), dtype=np.int64)]
    at = 0
    while at < len(section):
        _, length, channel, entries_size = _INDEX_HEAD.unpack_from(section, at)
        pairs = np.frombuffer(section, dtype="<i8", count=entries_size // 8, offset=at + _INDEX_HEAD.size).reshape(
            -1, 2
        )
        entries.append(np.column_stack([np.full(len(pairs), channel), pairs]))
        if length != entries_size + _INDEX_HEAD.size - _RECORD_HEAD or section[at] != Opcode.MESSAGE_INDEX:
            raise DamagedError(f"the index of {where} is no index")
        places[channel] = listed.chunk_start_offset + listed.chunk_length + at
        at += _RECORD_HEAD + length
    indexed = np.concatenate(entries)
    if listed.message_index_offsets != places:
        raise DamagedError("its index is not that of its chunks")
    if places and not np.array_equal(indexed[np.argsort(indexed[:, 2], kind="stable")], rows[:, :3]):
        raise DamagedError(f"the index of {where} is not that of its messages")


def cut_off(path: Path) -> str | None:
    """Return what is whole of a file that begins as an mcap file and does not end as one; None for any other file."""
    with path.open("rb") as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return None
        stream.seek(-len(MCAP_MAGIC), 2)
        if stream.tell() and stream.read() == MCAP_MAGIC:
            return None
        stream.seek(0)
        count = end_ns = last_ns = 0
        with suppress(Exception):  # where the file ends, within a record
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    last_ns = max(last_ns, record.message_end_time)
                elif isinstance(record, MessageIndex):
                    count, end_ns = count + len(record.records), last_ns
    if not count:
        return "is cut off before its first whole chunk: nothing can be recovered"
    return (
        f"is cut off (its recorder was killed, or the disk was full?): {count} messages up to t = "
        f"{end_ns / NANOSECONDS:.6f} s are whole, 'mcap recover' restores them"
    )
