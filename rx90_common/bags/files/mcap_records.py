"""The records of an mcap file (https://mcap.dev/spec), as far as reading and checking a bag needs them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from enum import IntEnum
from typing import Final, NamedTuple

from rx90_common.bags.files.contents import DamagedError
from rx90_common.base.quoting import quoted

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD_BYTES: Final = 9
"""Before each record: its kind, and the length of what follows."""

_HEAD = struct.Struct("<BQ")
_LENGTH = struct.Struct("<I")


class Op(IntEnum):
    """The kinds of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    STATISTICS = 0x0B
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


class RecordPlace(NamedTuple):
    """Where a record stands: its content is [start, end), HEAD_BYTES before it the record begins."""

    op: int
    start: int
    end: int


def walk(data: bytes, start: int, end: int) -> Iterator[RecordPlace]:
    """Yield the records between two places, which they must fill.

    Args:
        data: anything that gives bytes for a slice.
        start: of the first record.
        end: of the last one.

    Raises:
        DamagedError: if a record is longer than there is room.
    """
    while start < end:
        if end - start < HEAD_BYTES:
            raise DamagedError(f"{end - start} bytes at byte {start} are no record")
        op, length = _HEAD.unpack(data[start : start + HEAD_BYTES])
        content = start + HEAD_BYTES
        if content + length > end:
            raise DamagedError(f"the record at byte {start} is {length:,} bytes long, {end - content:,} are left")
        yield RecordPlace(op, content, content + length)
        start = content + length


class Fields:
    """Reads the fields of a record, one after the other.

    Args:
        content: of the record.
    """

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def numbers(self, layout: struct.Struct) -> tuple[int, ...]:
        """Return the next numbers."""
        return layout.unpack(self._take(layout.size))

    def block(self) -> bytes:
        """Return the next field, whose length in bytes stands before it."""
        return self._take(_LENGTH.unpack(self._take(_LENGTH.size))[0])

    def text(self) -> str:
        """Return the next text."""
        content = self.block()
        try:
            return content.decode()
        except UnicodeDecodeError as error:
            raise DamagedError(f"a text is {quoted(content)}; accepted: UTF-8") from error

    def position(self) -> int:
        """Return the place of the next field."""
        return self._at

    def left(self) -> int:
        """Return how many bytes have not been read."""
        return len(self._content) - self._at

    def _take(self, size: int) -> bytes:
        end = self._at + size
        if end > len(self._content):
            raise DamagedError(f"a record of {len(self._content)} bytes is cut off")
        part, self._at = self._content[self._at : end], end
        return part


class McapSchema(NamedTuple):
    """A type of messages."""

    name: str
    encoding: str
    data: bytes


class McapChannel(NamedTuple):
    """What messages are published on; `schema` is 0 where there is none."""

    schema: int
    topic: str
    encoding: str


_ID = struct.Struct("<H")


class Dictionary:
    """The schemas and channels of a file by their numbers; each record of one must be as the others."""

    def __init__(self) -> None:
        self.schemas: dict[int, McapSchema] = {}
        self.channels: dict[int, McapChannel] = {}

    def add(self, op: int, content: bytes) -> None:
        """Take a record that is a schema or a channel; others are not looked at.

        Raises:
            DamagedError: if it is cut off, or not the same as one before.
        """
        if op not in (Op.SCHEMA, Op.CHANNEL):
            return
        fields = Fields(content)
        (number,) = fields.numbers(_ID)
        if op == Op.SCHEMA:
            schema = McapSchema(fields.text(), fields.text(), fields.block())
            same = self.schemas.setdefault(number, schema) == schema
        else:
            channel = McapChannel(fields.numbers(_ID)[0], fields.text(), fields.text())
            about = Fields(fields.block())
            while about.left():  # a reader that follows lengths beyond it misses the messages behind the channel
                about.text()
            same = self.channels.setdefault(number, channel) == channel
        if not same:
            raise DamagedError(f"{Op(op).name.lower()} {number} is described in two ways")

    def type_of(self, channel: McapChannel) -> str:
        """Return the name of a channel's type, empty without one.

        Raises:
            DamagedError: if its schema is not there.
        """
        if channel.schema and channel.schema not in self.schemas:
            raise DamagedError(f"{quoted(channel.topic)} is of schema {channel.schema}, which is not there")
        return self.schemas[channel.schema].name if channel.schema else ""
