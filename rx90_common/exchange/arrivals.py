"""Callbacks for arriving messages, on the middleware's own thread, without the interpreter.

rclpy has no function for rcl's callback for new messages. A channel counts messages with it: polling the middleware
would take, each time, the lock that its receiving thread needs to deliver a message. A recorder
gathers messages with it: waking a sleeping receiving thread costs the publisher more than the message itself, so that
thread sleeps for fixed pauses, and finds many messages at once.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from rclpy.subscription import Subscription

from rx90_common.base.rates import NANOSECONDS
from rx90_common.kernels.compiled import c_function, inlined

_OK = 0
_MICROSECONDS = 1_000_000

# The numbers that `_receive_batch` uses: the pause in us, the number of pauses, and a slot for each receiving
# thread: its id, its voluntary context switches after its last pause, the time of its last call in ns, and room for
# the system's answer: a struct timespec or a struct rusage, here of 64-bit numbers.
_PAUSE = 0
_PAUSES = 1
_SLOTS = 2
_SLOT_LENGTH = 21
_MAX_THREADS = 16  # further ones do not pause
_BATCH_LENGTH = _SLOTS + _SLOT_LENGTH * _MAX_THREADS
# in a slot
_SWITCHES = 1
_LAST = 2
_ANSWER = 3
_USAGE_SWITCHES = 16  # in struct rusage
_CLOCK_MONOTONIC = 1
_RUSAGE_THREAD = 1
_AT_ONCE_NS = 20_000  # between two messages that were both there; asking for the switches takes half a message

_clock_gettime: Any = types.ExternalFunction(
    "clock_gettime", types.int32(types.int32, types.voidptr)
)
_getrusage: Any = types.ExternalFunction("getrusage", types.int32(types.int32, types.voidptr))
_pthread_self: Any = types.ExternalFunction("pthread_self", types.int64())
_usleep: Any = types.ExternalFunction("usleep", types.int32(types.uint32))

# Some bytes for each subscription, never freed: the middleware does not report its last call.
_kept: list[object] = []


@c_function(types.int64(types.voidptr, types.int64))
def _count(counter_at, _messages):  # type: ignore[no-untyped-def]  # an address and a number
    """Be the callback; rcl's has no result, and ignores this one.

    Messages that came before it was set count as one together; the first take that finds nothing corrects the count.
    """
    counter = carray(counter_at, (1,), np.int64)
    counter[0] += 1
    return 0


@inlined
def _now(answer):  # type: ignore[no-untyped-def]  # an array
    _clock_gettime(_CLOCK_MONOTONIC, answer.ctypes)
    return answer[0] * NANOSECONDS + answer[1]


@inlined
def _switches(answer):  # type: ignore[no-untyped-def]  # an array
    _getrusage(_RUSAGE_THREAD, answer.ctypes)
    return answer[_USAGE_SWITCHES]


@c_function(types.int64(types.voidptr, types.int64))
def _receive_batch(state_at, _messages):  # type: ignore[no-untyped-def]  # an address and a number
    """Be the callback: sleep, if this thread has given the processor away since its last pause, to wait for a message.

    A thread that finds the next message already there has not done so, and takes one after the other.
    """
    state = carray(state_at, (_BATCH_LENGTH,), np.int64)
    thread = _pthread_self()
    at = _SLOTS
    while state[at] != thread:
        if state[at] == 0:
            state[at] = thread
        else:
            at += _SLOT_LENGTH
            if at == _BATCH_LENGTH:
                return 0
    slot = state[at : at + _SLOT_LENGTH]
    answer = slot[_ANSWER:]
    if _now(answer) - slot[_LAST] > _AT_ONCE_NS and _switches(answer) != slot[_SWITCHES]:
        _usleep(state[_PAUSE])
        slot[_SWITCHES] = _switches(answer)
        state[_PAUSES] += 1
    slot[_LAST] = _now(answer)
    return 0


def count_arrivals(subscription: Subscription, counter: ctypes.c_int64) -> bool:
    """Add 1 to `counter` with each message that arrives from now on, on the middleware's thread.

    Returns:
        Whether messages are counted: not every middleware has such a callback.
    """
    _kept.append(counter)
    return _set_callback(subscription, _count(), ctypes.addressof(counter))


class ReceiveBatching:
    """Lets receiving threads sleep, before a message that they had to wait for, while more messages arrive.

    For subscriptions on which nobody waits: a thread sleeps with the locks of one of them. The messages arriving in a
    pause must fit into the socket.

    Args:
        pause: s.
    """

    def __init__(self, pause: float) -> None:
        self._state = np.zeros(_BATCH_LENGTH, dtype=np.int64)
        self._state[_PAUSE] = round(pause * _MICROSECONDS)
        self._callback = _receive_batch()
        _kept.append(self._state)

    def include(self, subscription: Subscription) -> bool:
        """Gather this subscription's messages too; all of a node's share a receiving thread.

        Returns:
            Whether they are gathered: not every middleware has such a callback.
        """
        return _set_callback(subscription, self._callback, self._state.ctypes.data)


def _set_callback(subscription: Subscription, function: object, argument: int) -> bool:
    """Let the middleware call a compiled function with this address for each message from now on."""
    try:
        set_callback = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
    except (OSError, AttributeError):
        return False
    set_callback.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    set_callback.restype = ctypes.c_int32
    callback = ctypes.cast(function, ctypes.c_void_p)  # type: ignore[arg-type]  # a function of ctypes
    with subscription.handle:
        return bool(set_callback(subscription.handle.pointer, callback, argument) == _OK)
