"""What the data section of an mcap file holds, and whether the summary behind it says the same."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NamedTuple

from rx90_common.bags.files.contents import DamagedError
from rx90_common.bags.files.mcap_records import HEAD_BYTES, MAGIC, Dictionary, Fields, Op, RecordPlace, walk

_CHUNK = struct.Struct("<QQQI")
_LONG = struct.Struct("<Q")
_CRC = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")
_MESSAGE = struct.Struct("<HIQQ")
_INDEX_CHANNEL = struct.Struct("<H")
_CHUNK_INDEX = struct.Struct("<QQQQ")
_OFFSET = struct.Struct("<HQ")
_SIZES = struct.Struct("<QQ")
_STATISTICS = struct.Struct("<QHIIIIQQ")
_SUMMARY_OFFSET = struct.Struct("<BQQ")
_INDEX_ENTRY_BYTES = 16
_CRC_STEP = 1 << 22


class IndexPart(NamedTuple):
    """The index of one channel's messages in a chunk: its record, and where the entries are."""

    channel: int
    record: int
    start: int
    end: int

    @property
    def messages(self) -> int:
        """Return how many messages it lists."""
        return (self.end - self.start) // _INDEX_ENTRY_BYTES


@dataclass
class McapBlock:
    """A chunk, or messages without one.

    Attributes:
        start: where its first record begins.
        end: behind its last byte, without the index.
        first_ns: earliest log time, as its head says.
        last_ns: latest.
        content: where what is in it stands: [start, end).
        compression: of the content; None for messages without a chunk.
        size: of the content when it is decompressed.
        crc: of the decompressed content, 0 without one.
        index: what follows it.
        count: its messages, once they have been counted.
    """

    start: int
    end: int
    first_ns: int
    last_ns: int
    content: tuple[int, int]
    compression: str | None = None
    size: int = 0
    crc: int = 0
    index: list[IndexPart] = field(default_factory=list)
    count: int = 0

    @property
    def index_end(self) -> int:
        """Return where the records of its index end."""
        return self.index[-1].end if self.index else self.end


@dataclass
class Structure:
    """The data section.

    Attributes:
        dictionary: schemas and channels that stand outside of chunks.
        blocks: chunks and messages without one, as they stand in the file.
        data_end: the record that ends the section.
        trusted: whether a checksum says that the summary is whole.
        listed: what the summary says of schemas and channels.
    """

    dictionary: Dictionary
    blocks: list[McapBlock]
    data_end: RecordPlace
    trusted: bool = False
    listed: Dictionary = field(default_factory=Dictionary)


def read_structure(data: bytes) -> Structure:
    """Walk through the records of a file, without looking into chunks.

    Raises:
        DamagedError: if they do not follow each other as they must.
    """
    dictionary = Dictionary()
    blocks: list[McapBlock] = []
    before = 0
    for place in walk(data, len(MAGIC), len(data) - len(MAGIC)):
        op = place.op
        if (op == Op.HEADER) is not (before == 0):
            raise DamagedError("the header does not stand at the beginning")
        if op == Op.DATA_END:
            return Structure(dictionary, blocks, place)
        if op == Op.CHUNK:
            blocks.append(_chunk(data, place))
        elif op == Op.MESSAGE:
            _add_message(blocks, data, place)
        elif op == Op.MESSAGE_INDEX:
            if before not in (Op.CHUNK, Op.MESSAGE_INDEX):
                raise DamagedError(f"the message index at byte {place.start} belongs to no chunk")
            blocks[-1].index.append(_index_part(data, place))
        elif op in (Op.FOOTER, Op.CHUNK_INDEX, Op.STATISTICS, Op.SUMMARY_OFFSET):
            raise DamagedError(f"the record {Op(op).name.lower()} at byte {place.start} stands among the data")
        else:
            dictionary.add(op, data[place.start : place.end])
        before = op
    raise DamagedError("the data section does not end")


def _chunk(data: bytes, place: RecordPlace) -> McapBlock:
    fields = Fields(data[place.start : min(place.end, place.start + 256)])
    first, last, size, crc = fields.numbers(_CHUNK)
    compression = fields.text()
    (length,) = fields.numbers(_LONG)
    start = place.start + fields.position()
    if start + length != place.end:
        raise DamagedError(f"the chunk at byte {place.start} has {length:,} bytes, its record {place.end - start:,}")
    return McapBlock(place.start - HEAD_BYTES, place.end, first, last, (start, place.end), compression, size, crc)


def _index_part(data: bytes, place: RecordPlace) -> IndexPart:
    fields = Fields(data[place.start : place.end])
    (channel,) = fields.numbers(_INDEX_CHANNEL)
    entries = fields.block()
    if fields.position() != place.end - place.start or len(entries) % _INDEX_ENTRY_BYTES:
        raise DamagedError(f"the message index at byte {place.start} is {len(entries)} bytes long")
    return IndexPart(channel, place.start - HEAD_BYTES, place.end - len(entries), place.end)


def _add_message(blocks: list[McapBlock], data: bytes, place: RecordPlace) -> None:
    """Add a message without a chunk to the block of those before it."""
    _, _, log_ns, _ = Fields(data[place.start : min(place.end, place.start + _MESSAGE.size)]).numbers(_MESSAGE)
    start = place.start - HEAD_BYTES
    last = blocks[-1] if blocks else None
    if last is None or last.compression is not None or last.end != start or place.end - last.start > _CRC_STEP:
        blocks.append(McapBlock(start, place.end, log_ns, log_ns, (start, place.end)))
        return
    last.end, last.content = place.end, (last.start, place.end)
    last.first_ns, last.last_ns = min(last.first_ns, log_ns), max(last.last_ns, log_ns)


def check_data_crc(data: bytes, structure: Structure) -> None:
    """Compare the checksum of the data section, if there is one, with its bytes.

    Raises:
        DamagedError: if they differ.
    """
    place = structure.data_end
    (expected,) = Fields(data[place.start : place.end]).numbers(_CRC)
    if not expected:
        return
    crc = 0
    for start in range(0, place.start - HEAD_BYTES, _CRC_STEP):
        crc = zlib.crc32(data[start : min(start + _CRC_STEP, place.start - HEAD_BYTES)], crc)
    if crc != expected:
        raise DamagedError("the checksum of its data does not match")


def check_summary(data: bytes, structure: Structure) -> RecordPlace | None:
    """Compare the summary with the data section, and take its schemas and channels; return the statistics, if any.

    Raises:
        DamagedError: if they differ, or the summary's checksum does not match.
    """
    start = structure.data_end.end
    places = list(walk(data, start, len(data) - len(MAGIC)))
    if not places or places[-1].op != Op.FOOTER:
        raise DamagedError("it does not end with a footer")
    _check_footer(data, structure, places)
    for place in places:
        if place.op in (Op.HEADER, Op.MESSAGE, Op.CHUNK, Op.MESSAGE_INDEX):
            raise DamagedError(f"the record {Op(place.op).name.lower()} at byte {place.start} stands behind the data")
        for dictionary in (structure.dictionary, structure.listed):
            dictionary.add(place.op, data[place.start : place.end])
    indexes = [data[place.start : place.end] for place in places if place.op == Op.CHUNK_INDEX]
    chunks = [block for block in structure.blocks if block.compression is not None]
    if indexes and sorted(map(_index_of, indexes)) != sorted(map(_expected_index, chunks)):
        raise DamagedError("its index is not that of its chunks")
    for place in places:
        if place.op == Op.SUMMARY_OFFSET:
            _check_offset(data, place, places)
    return next((place for place in places if place.op == Op.STATISTICS), None)


def _check_footer(data: bytes, structure: Structure, places: list[RecordPlace]) -> None:
    footer = places[-1]
    if footer.end - footer.start != _FOOTER.size:
        raise DamagedError(f"its footer is {footer.end - footer.start} bytes long")
    summary, offsets, crc = Fields(data[footer.start : footer.end]).numbers(_FOOTER)
    start = structure.data_end.end
    first = next((p.start for p in places if p.op == Op.SUMMARY_OFFSET), footer.start) - HEAD_BYTES
    if summary not in ((start,) if len(places) > 1 else (start, 0)) or offsets not in (first, 0):
        raise DamagedError("its footer does not point to its summary")
    if crc and crc != zlib.crc32(data[start : footer.end - _CRC.size]):
        raise DamagedError("the checksum of its summary does not match")
    structure.trusted = crc != 0


def _check_offset(data: bytes, place: RecordPlace, places: list[RecordPlace]) -> None:
    op, start, length = Fields(data[place.start : place.end]).numbers(_SUMMARY_OFFSET)
    if op not in (Op.SCHEMA, Op.CHANNEL, Op.CHUNK_INDEX, Op.STATISTICS):
        return  # leads to no messages; rosbags once pointed it elsewhere
    group = [p for p in places if p.op == op]
    if group and (group[0].start - HEAD_BYTES, group[-1].end) != (start, start + length):
        raise DamagedError("its summary offsets do not point to what they should")


_Index = tuple[int, int, int, int, list[tuple[int, int]], int, str, int, int]


def _index_of(content: bytes) -> _Index:
    fields = Fields(content)
    first, last, start, length = fields.numbers(_CHUNK_INDEX)
    offsets = fields.block()
    if len(offsets) % _OFFSET.size:
        raise DamagedError("its index is cut off")
    (index_length,) = fields.numbers(_LONG)
    compression = fields.text()
    return (
        start, length, first, last, sorted(_OFFSET.iter_unpack(offsets)), index_length, compression,
        *fields.numbers(_SIZES),
    )  # type: ignore[return-value]  # fmt: skip


def _expected_index(block: McapBlock) -> _Index:
    offsets = sorted((part.channel, part.record) for part in block.index)
    return (
        block.start, block.end - block.start, block.first_ns, block.last_ns, offsets, block.index_end - block.end,
        block.compression or "", block.content[1] - block.content[0], block.size,
    )  # fmt: skip


def check_channels(structure: Structure, used: Collection[int]) -> None:
    """Check that the summary, if it lists channels, lists those that have messages, and their schemas.

    Raises:
        DamagedError: naming one that it lacks.
    """
    listed = structure.listed
    for number in used if listed.channels else ():
        if number not in listed.channels:
            raise DamagedError(f"its summary lacks channel {number}, which has messages")
        schema = listed.channels[number].schema
        if schema and listed.schemas and schema not in listed.schemas:
            raise DamagedError(f"its summary lacks schema {schema}, of which channel {number} is")


def check_statistics(data: bytes, place: RecordPlace, structure: Structure, counts: Counter[int]) -> None:
    """Compare the statistics with the messages that there are, by channel.

    Raises:
        DamagedError: if they differ.
    """
    fields = Fields(data[place.start : place.end])
    total, _, _, _, _, chunks, first, last = fields.numbers(_STATISTICS)
    entries = fields.block()
    if len(entries) % _OFFSET.size:
        raise DamagedError("its statistics are cut off")
    listed = {channel: count for channel, count in _OFFSET.iter_unpack(entries) if count}
    if total != counts.total() or (listed and listed != {c: n for c, n in counts.items() if n}):
        raise DamagedError(f"its statistics say {total:,} messages, there are {counts.total():,}")
    if chunks != sum(block.compression is not None for block in structure.blocks):
        raise DamagedError(f"its statistics say {chunks:,} chunks")
    filled = [block for block in structure.blocks if block.count]
    lowest, highest = (min(b.first_ns for b in filled), max(b.last_ns for b in filled)) if filled else (0, 0)
    # Where the first time is 0, the writer of the mcap project gives the first time that is not.
    if total and (last != highest or (first != lowest and lowest)):
        raise DamagedError("its statistics say other times than its messages have")
