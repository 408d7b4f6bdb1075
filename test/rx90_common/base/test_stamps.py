"""Times at the head of messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Literal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.exchange.cdr import LITTLE_ENDIAN, cdr_stamp_ns, cdr_stamps_ns, message_time_ns

LAST = (1 << 31) * 10**9 - 1


def message(stamp: int, order: Literal["little", "big"] = "little") -> bytes:
    """Return a CDR message that begins with a stamp, ns."""
    seconds, nanoseconds = divmod(stamp, 10**9)
    flag = LITTLE_ENDIAN if order == "little" else bytes(4)
    return flag + seconds.to_bytes(4, order, signed=True) + nanoseconds.to_bytes(4, order) + b"rest"


@given(st.integers(-LAST, LAST), st.sampled_from(["little", "big"]))
def test_a_stamp_is_read_in_both_byte_orders(stamp: int, order: Literal["little", "big"]) -> None:
    """Head and message object give the same nanoseconds, also before 0; a message that is cut off gives -1."""
    seconds, nanoseconds = divmod(stamp, 10**9)
    assert cdr_stamp_ns(message(stamp, order)) == stamp
    assert message_time_ns(SimpleNamespace(sec=seconds, nanosec=nanoseconds)) == stamp
    assert cdr_stamp_ns(message(stamp, order)[:11]) == -1


@given(st.lists(st.integers(-LAST, LAST), min_size=1))
def test_many_stamps_are_those_one_by_one(stamps: list[int]) -> None:
    """The stamps of a block of messages are those of each."""
    block = np.frombuffer(b"".join(message(stamp) for stamp in stamps), dtype=np.uint8).reshape(len(stamps), -1)
    assert cdr_stamps_ns(block).tolist() == stamps
