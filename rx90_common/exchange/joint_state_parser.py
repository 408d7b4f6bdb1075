"""Read a sensor_msgs/JointState from CDR bytes of any layout, and say clearly what is wrong with them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, STAMP_BYTES, cdr_stamp

_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # the two plain encodings of CDR
_MAX_SLACK = 15  # serialisers reserve alignment and counts that they then do not need

Arrays = tuple[NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.float64] | None]


def parse_joint_state(raw: bytes, names: Sequence[str]) -> tuple[int, Arrays]:
    """Return stamp_ns and (position, velocity, effort) in the order of `names`, None for an empty array.

    Raises:
        ExchangeError: see `JointStateCodec.decode`.
    """
    reader = _CdrReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string("header.frame_id")
    found = [reader.string(f"name[{i}]") for i in range(reader.count("name", least_bytes=4))]
    order = _order(found, names)
    position, velocity, effort = (
        _pick(reader.doubles(field), order, field, names) for field in ("position", "velocity", "effort")
    )
    reader.finish()
    return stamp_ns, (position, velocity, effort)


class _CdrReader:
    """Walk through the body of a CDR message; alignment counts from the body's start."""

    def __init__(self, raw: bytes) -> None:
        if len(raw) < ENCAPSULATION:
            raise ExchangeError(f"message is cut off: {len(raw)} bytes, no CDR encapsulation")
        order = _BYTE_ORDERS.get(bytes(raw[:2]))
        if order is None:
            found = bytes(raw[:2]).hex()
            raise ExchangeError(f"message has the encapsulation 0x{found}; accepted: plain CDR, 0x0000 or 0x0001")
        self._order = order
        self._raw, self._body = raw, raw[ENCAPSULATION:]
        self._at = 0

    def _take(self, size: int, alignment: int, what: str) -> bytes:
        start = self._at + -self._at % alignment
        if start + size > len(self._body):
            raise ExchangeError(f"message is cut off in {what}: {len(self._body)} bytes of body, {start + size} needed")
        self._at = start + size
        return self._body[start : self._at]

    def stamp_ns(self) -> int:
        """Return the stamp, with which the body begins."""
        self._take(STAMP_BYTES, 4, "header.stamp")
        seconds, nanoseconds = cdr_stamp(self._raw)
        if nanoseconds >= NANOSECONDS:
            raise ExchangeError(f"header.stamp.nanosec is {nanoseconds}; accepted: 0 to {NANOSECONDS - 1}")
        return seconds * NANOSECONDS + nanoseconds

    def count(self, what: str, least_bytes: int) -> int:
        """Return a length; refuse one that the rest of the message cannot hold before anything is built."""
        (count,) = struct.unpack(f"{self._order}I", self._take(4, 4, what))
        left = len(self._body) - self._at
        if count * least_bytes > left:
            raise ExchangeError(f"message is cut off in {what}: {count} elements announced, {left} bytes left")
        return int(count)

    def string(self, what: str) -> str:
        content = self._take(self.count(what, least_bytes=1), 1, what)
        try:
            return content.rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise ExchangeError(f"{what} is {quoted(content)}; accepted: UTF-8") from error

    def doubles(self, what: str) -> NDArray[np.float64]:
        count = self.count(what, least_bytes=8)
        content = self._take(8 * count, 8, what) if count else b""
        return np.frombuffer(content, dtype=f"{self._order}f8").astype(np.float64)

    def finish(self) -> None:
        left = len(self._body) - self._at
        if left > _MAX_SLACK:
            raise ExchangeError(f"message has {left} bytes behind its end; it is no sensor_msgs/JointState")


def _order(found: list[str], names: Sequence[str]) -> list[int]:
    """Return where each of `names` stands in the message."""
    for name in found:
        if name not in names:
            raise ExchangeError(f"joint name {quoted(name)} is unknown; accepted: {', '.join(names)}")
        if found.count(name) > 1:
            raise ExchangeError(f"joint name {quoted(name)} is repeated; accepted: {', '.join(names)}, each once")
    missing = [name for name in names if name not in found]
    if missing:
        raise ExchangeError(f"joint name {quoted(missing[0])} is missing; accepted: {', '.join(names)}, each once")
    return [found.index(name) for name in names]


def _pick(
    values: NDArray[np.float64], order: list[int], field: str, names: Sequence[str]
) -> NDArray[np.float64] | None:
    if not values.size:
        return None
    if values.size != len(names):
        raise ExchangeError(f"{field} has {values.size} elements; accepted: {len(names)} or none")
    picked = values[order]
    finite = np.isfinite(picked)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise ExchangeError(f"{field} of {names[bad]} is {picked[bad]}; accepted: a finite number")
    return picked
