"""A message of constant bytes with a stamp and numbers in it: read and written by compiled code in one call.

Between two ticks the processor does so much else that its caches hold nothing of the codec; what counts then is how
much code runs, and Python's own is the most. Frames are handed over as addresses, because numba takes longer to look at
an array than these functions need for their work.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so

from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION
from rx90_common.kernels.compiled import c_function

# shape: bytes of the message, numbers in a block, and for each of three blocks where it begins in memory, or -1.
# The message begins at byte 4 of its memory, so that the numbers, aligned from byte 4 of the message on, are aligned.
MARGIN = 4
SHAPE_LENGTH = 5
NO_MATCH = -1

_BLOCKS = 3
_STAMP_AT = MARGIN + ENCAPSULATION


@c_function(types.int64(types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr))
def read_frame(raw_at, expected_at, mask_at, memory_at, shape_at):  # type: ignore[no-untyped-def]  # addresses
    """Copy a message to `memory` and return its stamp, ns, or NO_MATCH if it is not of the expected form.

    Args:
        raw_at: the message, as long as the frame.
        expected_at: the frame's constant bytes.
        mask_at: 255 where a byte must be the expected one, else 0.
        memory_at: where to copy it, MARGIN bytes further.
        shape_at: the frame's shape, int64.
    """
    shape = carray(shape_at, (SHAPE_LENGTH,), np.int64)
    size = shape[0]
    raw = carray(raw_at, (size,), np.uint8)
    expected, mask = carray(expected_at, (size,), np.uint8), carray(mask_at, (size,), np.uint8)
    memory = carray(memory_at, (MARGIN + size,), np.uint8)
    different = np.uint8(0)
    for i in range(size):
        different |= (raw[i] ^ expected[i]) & mask[i]
        memory[MARGIN + i] = raw[i]
    if different != 0:
        return NO_MATCH
    stamp = carray(memory_at, (_STAMP_AT // 4 + 2,), np.uint32)
    seconds, nanoseconds = np.int64(stamp[_STAMP_AT // 4]), np.int64(stamp[_STAMP_AT // 4 + 1])
    if seconds > 0x7FFFFFFF or nanoseconds >= NANOSECONDS:
        return NO_MATCH
    numbers = carray(memory_at, ((MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block]
        if at >= 0:
            for i in range(at // 8, at // 8 + shape[1]):
                if not math.isfinite(numbers[i]):
                    return NO_MATCH
    return seconds * NANOSECONDS + nanoseconds


@c_function(types.int64(types.int64, types.voidptr, types.voidptr, types.voidptr, types.voidptr, types.voidptr))
def write_frame(stamp_ns, memory_at, first_at, second_at, third_at, shape_at):  # type: ignore[no-untyped-def]  # addresses
    """Write stamp and numbers into a frame whose constant bytes are in `memory` already.

    Args:
        stamp_ns: the stamp, ns.
        memory_at: the frame, MARGIN bytes before it.
        first_at: numbers of the first block; not looked at if the frame has none.
        second_at: of the second.
        third_at: of the third.
        shape_at: the frame's shape, int64.
    """
    shape = carray(shape_at, (SHAPE_LENGTH,), np.int64)
    size, count = shape[0], shape[1]
    stamp = carray(memory_at, (_STAMP_AT // 4 + 2,), np.uint32)
    stamp[_STAMP_AT // 4] = stamp_ns // NANOSECONDS
    stamp[_STAMP_AT // 4 + 1] = stamp_ns % NANOSECONDS
    numbers = carray(memory_at, ((MARGIN + size) // 8,), np.float64)
    for block in range(_BLOCKS):
        at = shape[2 + block] // 8
        if shape[2 + block] >= 0:
            address = first_at if block == 0 else second_at if block == 1 else third_at
            values = carray(address, (count,), np.float64)
            for i in range(count):
                numbers[at + i] = values[i]
    return 0
