"""A count of arriving messages, kept on the middleware's own thread, without the interpreter.

rclpy has no function for rcl's callback for new messages. A channel counts messages with it: polling the middleware
would take, each time, the lock that its receiving thread needs to deliver a message.
"""

from __future__ import annotations

import ctypes

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from rclpy.subscription import Subscription

from rx90_common.kernels.compiled import c_function

_OK = 0
# Some bytes for each subscription, never freed: the middleware does not report its last call.
_kept: list[ctypes.c_int64] = []


@c_function(types.int64(types.voidptr, types.int64))
def _count(counter_at, _messages):  # type: ignore[no-untyped-def]  # an address and a number
    """Be the callback; rcl's has no result, and ignores this one.

    Messages that came before it was set count as one together; the first take that finds nothing corrects the count.
    """
    counter = carray(counter_at, (1,), np.int64)
    counter[0] += 1
    return 0


def count_arrivals(subscription: Subscription, counter: ctypes.c_int64) -> bool:
    """Add 1 to `counter` with each message that arrives from now on, on the middleware's thread.

    Returns:
        Whether messages are counted: not every middleware has such a callback.
    """
    try:
        set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
    except (OSError, AttributeError):
        return False
    _kept.append(counter)
    set_callback.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    set_callback.restype = ctypes.c_int32
    callback = ctypes.cast(_count(), ctypes.c_void_p)  # type: ignore[arg-type]  # a function of ctypes
    with subscription.handle:
        answer = set_callback(subscription.handle.pointer, callback, ctypes.addressof(counter))
    return bool(answer == _OK)
