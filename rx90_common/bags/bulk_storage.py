"""rosbags' writer, with messages handed over in batches: the same files, byte for byte, in a fraction of the time."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path
from typing import Final
from zlib import crc32

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.kernels.compiled import c_function

_CHUNK_BYTES: Final = 1 << 20  # a chunk that is larger is closed, as rosbags does
_CHUNK, _MESSAGE, _MESSAGE_INDEX = 0x06, 0x05, 0x07
_RECORD_HEAD: Final = 9  # op code and length
_MESSAGE_HEAD: Final = 22  # channel, sequence number, log time, time of publication
_FOOTER = struct.Struct("<QQI")  # places of summary and offsets, checksum
_CRC = struct.Struct("<I")
_MAGIC_BYTES = 8  # at the end of a file
_NONE_YET = 2**63 - 1  # what rosbags has for the start of an empty chunk


@c_function(types.int64(*[types.voidptr] * 5, types.int64, types.voidptr))
def _write_records(data_at, start_at, size_at, channel_at, log_at, count, to_at):  # type: ignore[no-untyped-def]
    """Write messages as MCAP records, one behind the other; the sequence number is 0, as in rosbags."""
    start, size = carray(start_at, (count,), np.int64), carray(size_at, (count,), np.int64)
    channel, log_ns = carray(channel_at, (count,), np.int64), carray(log_at, (count,), np.int64)
    end = 0
    for i in range(count):
        length = size[i]
        message = carray(data_at, (start[i] + length,), np.uint8)[start[i] :]
        record = carray(to_at, (end + _RECORD_HEAD + _MESSAGE_HEAD + length,), np.uint8)[end:]
        record[0] = _MESSAGE
        for k in range(8):
            record[1 + k] = (_MESSAGE_HEAD + length) >> (8 * k) & 255
            record[15 + k] = record[23 + k] = log_ns[i] >> (8 * k) & 255
        record[9], record[10] = channel[i] & 255, channel[i] >> 8
        record[11] = record[12] = record[13] = record[14] = 0
        for k in range(length):
            record[_RECORD_HEAD + _MESSAGE_HEAD + k] = message[k]
        end += len(record)
    return 0


class BulkMcapWriter(McapWriter):
    """rosbags' MCAP writer; messages come by `write_many` alone, and chunks and summary get checksums."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._index: dict[int, list[bytes]] = {}  # of the pending chunk, by channel: times and places

    def write_many(self, channel: Int64Array, log_ns: Int64Array, messages: MessageBatch) -> None:
        """Write messages, in this order, of the channels with these numbers, int64 (n,)."""
        size = messages.size + (_RECORD_HEAD + _MESSAGE_HEAD)
        ends = np.cumsum(size)
        begin = 0
        while begin < len(size):
            place = self.chunk.bio.tell() + ends - size - (ends[begin] - size[begin])
            end = min(int(np.searchsorted(place + size, _CHUNK_BYTES, side="right")) + 1, len(size))
            rows = slice(begin, end)
            parts: list[Int64Array] = [messages.start[rows], messages.size[rows], channel[rows], log_ns[rows]]
            fields = [np.ascontiguousarray(part) for part in parts]  # as long as their addresses are used
            records = np.empty(int(size[rows].sum()), dtype=np.uint8)
            addresses = [field.ctypes.data for field in fields]
            _write_records(messages.data.ctypes.data, *addresses, end - begin, records.ctypes.data)
            self.chunk.bio.write(records.data)
            self._note(channel[rows], log_ns[rows], place[rows])
            if self.chunk.bio.tell() > _CHUNK_BYTES:
                self.close_chunk()
            begin = end

    def _note(self, channel: Int64Array, log_ns: Int64Array, place: Int64Array) -> None:
        """Note where in the pending chunk messages begin, and their times."""
        for noted in (self, self.chunk):
            noted.message_start_time = min(int(log_ns.min()), noted.message_start_time)
            noted.message_end_time = max(int(log_ns.max()), noted.message_end_time)
        entries = np.column_stack((log_ns, place)).astype("<i8", copy=False)
        numbers, firsts, counts = np.unique(channel, return_index=True, return_counts=True)
        for k in np.argsort(firsts):
            number = int(numbers[k])
            self.channel_stats[number] += int(counts[k])
            self._index.setdefault(number, []).append(entries[channel == number].tobytes())

    def checkpoint(self) -> None:
        """Hand what is pending to the system."""
        if self._index:
            self.close_chunk()
        self.bio.flush()

    def close_chunk(self) -> None:
        """Write the pending chunk with its index, and note it for the summary."""
        chunk = self.chunk
        size = chunk.bio.tell()
        content = chunk.bio.getvalue()
        records = self.compressor(content)
        times = struct.pack("<QQ", chunk.message_start_time, chunk.message_end_time)
        compression = self.compression.encode()
        name = struct.pack("<I", len(compression)) + compression
        start = self._write(
            _CHUNK, times, struct.pack("<QI", size, crc32(content)), name, struct.pack("<Q", len(records)), records
        )
        end = self.bio.tell()
        places = b""
        for number, entries in self._index.items():
            length = sum(map(len, entries))
            places += struct.pack(
                "<HQ", number, self._write(_MESSAGE_INDEX, struct.pack("<HI", number, length), *entries)
            )
        summary = BytesIO()
        summary.write(times + struct.pack("<QQI", start, end - start, len(places)) + places)
        summary.write(struct.pack("<Q", self.bio.tell() - end) + name + struct.pack("<QQ", len(records), size))
        self.chunks.append(summary)
        # Last: what cannot be written stays pending.
        self.chunk = PendingChunk(_NONE_YET, 0, BytesIO(), chunk.msgs)
        self._index = {}

    def close(self, version: int, metadata: str) -> None:
        """Write the summary and close the file."""
        super().close(version, metadata)
        with self.path.open("r+b") as stream:
            stream.seek(-_FOOTER.size - _MAGIC_BYTES, 2)
            summary, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
            stream.seek(summary)
            crc = crc32(stream.read()[: -_CRC.size - _MAGIC_BYTES])
            stream.seek(-_CRC.size - _MAGIC_BYTES, 2)
            stream.write(_CRC.pack(crc))

    def _write(self, code: int, *parts: bytes) -> int:
        """Write a record to the file; return where it begins."""
        at = self.bio.tell()
        self.bio.write(struct.pack("<BQ", code, sum(map(len, parts))))
        for part in parts:
            self.bio.write(part)
        return at


class BulkSqlite3Writer(Sqlite3Writer):
    """rosbags' SQLite writer."""

    def write_many(self, channel: Int64Array, log_ns: Int64Array, messages: MessageBatch) -> None:
        """Write messages, in this order, of the topics with these numbers, int64 (n,)."""
        rows = zip(channel.tolist(), log_ns.tolist(), messages, strict=True)
        self.cursor.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)", rows)

    def checkpoint(self) -> None:
        """Hand what is pending to the system."""
        self.conn.commit()


class BulkWriter(Writer):
    """rosbags' writer, whose storage takes messages by `write_many` alone."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: BulkMcapWriter, StoragePlugin.SQLITE3: BulkSqlite3Writer}  # noqa: RUF012 - as in rosbags
