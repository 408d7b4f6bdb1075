"""Rates of the loops, and stamps of messages."""

from types import SimpleNamespace
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import NANOSECONDS, Rates, message_time_ns, ticks_per
from rx90_common.exchange.cdr_stamps import LITTLE_ENDIAN, cdr_stamp_ns


def test_rates_that_do_not_divide_are_refused() -> None:
    """Without a whole period in ns, or a whole number of ticks for one of a loop or topic: by name and value."""
    for base in (0, -4000, 3000, 7, NANOSECONDS + 1):
        with pytest.raises(ConfigError, match=rf"base_rate is {base} Hz; accepted"):
            Rates(base, 1)
    for position in (0, -1, 3, 300, 8000):
        with pytest.raises(ConfigError, match=rf"position_rate is {position} Hz; accepted: .* 4000 Hz, such as .*1000"):
            Rates(4000, position)
    assert ticks_per("clock_rate", 4000, 100) == 40
    with pytest.raises(ConfigError, match="clock_rate is 30 Hz"):
        ticks_per("clock_rate", 4000, 30)


LAST = (1 << 31) * 10**9 - 1


def message(stamp: int, order: Literal["little", "big"] = "little") -> bytes:
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
