"""Take all messages that have come on a subscription, in one call of compiled code and without the interpreter's lock.

rclpy takes one message per call and makes a bytes object, a dict and a tuple of it, while the thread that writes the
bag waits for the lock.
"""

from __future__ import annotations

import ctypes
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from llvmlite import ir
from numba import carray, extending, types  # type: ignore[attr-defined]  # numba exports without saying so
from rclpy.subscription import Subscription

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.base.errors import BagError
from rx90_common.kernels.compiled import c_function

_OK: Final = 0
_NOTHING_THERE: Final = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
_NO_ROOM: Final = -1
_FIRST_ROOM = 1 << 16  # bytes
_SLICE: Final = 512  # messages of a call

# What `_take_all` works on, as 64-bit numbers: addresses, sizes, what it has done, and a row for each message.
_FUNCTION, _SUBSCRIPTION, _MESSAGE, _INFO, _MEMORY, _ROOM, _COUNT, _USED, _LEFT = range(9)
_ROWS: Final = 9
_ROW: Final = 5  # sequence number, time of reception, start, size, time of sending
_STATE_LENGTH: Final = _ROWS + _ROW * _SLICE
_MESSAGE_LENGTH: Final = 8  # rcl_serialized_message_t: buffer, size, capacity, and an allocator of five pointers
_BUFFER, _SIZE = 0, 1
_INFO_LENGTH: Final = 16  # an rmw_message_info_t is shorter
_SENT, _RECEIVED, _NUMBER = 0, 1, 2

_intrinsic: Any = extending.intrinsic
_memcpy: Any = types.ExternalFunction("memcpy", types.voidptr(types.voidptr, types.voidptr, types.int64))


@_intrinsic
def _pointer(_typing, _address):  # type: ignore[no-untyped-def]  # numba types
    """Return the address in an int64 as a pointer."""

    def emit(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]  # LLVM values
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), emit


@_intrinsic
def _call(_typing, _function, _subscription, _message, _info):  # type: ignore[no-untyped-def]  # numba types
    """Call rcl_take_serialized_message, whose address is the first argument, with the others."""

    def emit(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]  # LLVM values
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer] * 4).as_pointer()
        address, *rest = (
            builder.inttoptr(argument, kind if i == 0 else pointer) for i, argument in enumerate(arguments)
        )
        return builder.call(address, [*rest, ir.Constant(pointer, None)])

    return types.int32(types.int64, types.int64, types.int64, types.int64), emit


@c_function(types.int64(types.voidptr), releases_lock=True)
def _take_all(state_at):  # type: ignore[no-untyped-def]  # an address
    """Take messages until there are none, the rows are full or the room is; return what ended it.

    A message that is taken and does not fit into the room is `left`, and the first one of the next call.
    """
    state = carray(state_at, (_STATE_LENGTH,), np.int64)
    message = carray(_pointer(state[_MESSAGE]), (_MESSAGE_LENGTH,), np.int64)
    info = carray(_pointer(state[_INFO]), (_INFO_LENGTH,), np.int64)
    while state[_COUNT] < _SLICE:
        if state[_LEFT] == 0:
            code = _call(state[_FUNCTION], state[_SUBSCRIPTION], state[_MESSAGE], state[_INFO])
            if code != _OK:
                return code
        used, size = state[_USED], message[_SIZE]
        if used + size > state[_ROOM]:
            state[_LEFT] = 1
            return _NO_ROOM
        _memcpy(_pointer(state[_MEMORY] + used), _pointer(message[_BUFFER]), size)
        row = _ROWS + _ROW * state[_COUNT]
        state[row], state[row + 1] = info[_NUMBER], info[_RECEIVED]
        state[row + 2], state[row + 3], state[row + 4] = used, size, info[_SENT]
        state[_COUNT], state[_USED], state[_LEFT] = state[_COUNT] + 1, used + size, 0
    return _OK


class Taken(NamedTuple):
    """n messages of one subscription in the order of arrival.

    Attributes:
        messages: as they came.
        numbers: their publishers' sequence numbers, int64 (n,).
        received_ns: the wall clock's time of reception, int64 (n,).
        sent_ns: their publishers' wall clocks' time of sending, int64 (n,).
    """

    messages: MessageBatch
    numbers: Int64Array
    received_ns: Int64Array
    sent_ns: Int64Array


class Taker(Protocol):
    """Takes the messages of one subscription."""

    def take(self) -> Taken:
        """Return messages that have come, not more than some hundred; none if there are none.

        Raises:
            BagError: if the middleware refuses.
        """


class _Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")]


class _SerializedMessage(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("size", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class BulkTaker:
    """Takes with rcl's own function, many messages in a call.

    Args:
        subscription: nobody else may take from it.
        topic: for messages to the user.
        function: rcl_take_serialized_message.
        message: where it puts a message, with memory that it may enlarge.
    """

    def __init__(self, subscription: Subscription, topic: str, function: Any, message: _SerializedMessage) -> None:
        self._handle = subscription.handle
        self._topic = topic
        self._kept = function, message  # the state holds their addresses
        self._info = np.zeros(_INFO_LENGTH, dtype=np.int64)
        self._memory = np.empty(_FIRST_ROOM, dtype=np.uint8)
        self._state = np.zeros(_STATE_LENGTH, dtype=np.int64)
        self._rows = self._state[_ROWS:].reshape(_SLICE, _ROW)
        self._state[_FUNCTION] = ctypes.cast(function, ctypes.c_void_p).value or 0
        self._state[_MESSAGE] = ctypes.addressof(message)
        self._state[_INFO] = self._info.ctypes.data
        self._state_at = self._state.ctypes.data
        self._make_room(_FIRST_ROOM)

    def take(self) -> Taken:
        """Return messages that have come; see `Taker`."""
        state = self._state
        state[_COUNT] = state[_USED] = 0
        with self._handle:
            state[_SUBSCRIPTION] = self._handle.pointer
            code = _take_all(self._state_at)
            while code == _NO_ROOM and state[_COUNT] == 0:
                self._make_room(2 * len(self._memory))
                code = _take_all(self._state_at)
        if code not in {_OK, _NOTHING_THERE, _NO_ROOM}:
            raise BagError(f"{self._topic}: no message can be taken (rcl says {code})")
        numbers, received_ns, start, size, sent_ns = self._rows[: state[_COUNT]].T.copy()
        return Taken(MessageBatch(self._memory[: state[_USED]].copy(), start, size), numbers, received_ns, sent_ns)

    def _make_room(self, size: int) -> None:
        self._memory = np.empty(size, dtype=np.uint8)
        self._state[_MEMORY], self._state[_ROOM] = self._memory.ctypes.data, size


class SingleTaker:
    """Takes with rclpy, message by message: where the functions that `BulkTaker` calls are not to be found."""

    def __init__(self, subscription: Subscription, message_class: Any) -> None:
        self._handle = subscription.handle
        self._message_class = message_class

    def take(self) -> Taken:
        """Return messages that have come; see `Taker`."""
        taken: list[tuple[bytes, dict[str, int]]] = []
        with self._handle:
            while len(taken) < _SLICE:
                message = self._handle.take_message(self._message_class, True)
                if message is None:
                    break
                taken.append(message)
        names = ("publication_sequence_number", "received_timestamp", "source_timestamp")
        columns = (np.array([info[name] for _, info in taken], dtype=np.int64) for name in names)
        return Taken(MessageBatch.of([raw for raw, _ in taken]), *columns)


def bulk_taker(subscription: Subscription, topic: str) -> BulkTaker | None:
    """Return a taker for a subscription, None where rcl's functions are not to be found."""
    try:
        function = ctypes.CDLL("librcl.so").rcl_take_serialized_message
        rcutils = ctypes.CDLL("librcutils.so")
        allocator, initialise = rcutils.rcutils_get_default_allocator, rcutils.rcutils_uint8_array_init
    except (OSError, AttributeError):
        return None
    allocator.restype = _Allocator
    initialise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
    message = _SerializedMessage()
    if initialise(ctypes.byref(message), _FIRST_ROOM, ctypes.byref(allocator())) != _OK:
        return None
    return BulkTaker(subscription, topic, function, message)
