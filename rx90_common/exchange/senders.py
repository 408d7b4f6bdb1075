"""Messages with the process that sent them: rclpy's own information about a message does not name its publisher."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import cache
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

NAMES_SENDERS = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_connextdds")
"""Middlewares whose messages have the GID of DDS; those of others equal that of no process, and count as strangers'."""

_OK = 0
_GID_LENGTH = 16
_PARTICIPANT = 12  # bytes of a GID that all endpoints of a process share, by the protocol of DDS


class _Allocator(ctypes.Structure):
    _fields_ = (("functions", ctypes.c_void_p * 4), ("state", ctypes.c_void_p))


class _Bytes(ctypes.Structure):
    """rcl's serialised message."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Information(ctypes.Structure):
    """Its struct rmw_message_info_s."""

    _fields_ = (
        ("times", ctypes.c_int64 * 2),
        ("sequence_numbers", ctypes.c_uint64 * 2),
        ("implementation", ctypes.c_char_p),
        ("publisher", ctypes.c_uint8 * _GID_LENGTH),
        ("from_intra_process", ctypes.c_bool),
    )


@cache
def _libraries() -> tuple[ctypes.CDLL, ctypes.CDLL]:
    """Return rcl and its utilities, with the types of the functions that are called."""
    rcl = ctypes.CDLL("librcl.so")
    rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
    utilities = ctypes.CDLL("librcutils.so")
    utilities.rcutils_get_default_allocator.restype = _Allocator
    return rcl, utilities


def take_with_sender(subscription: Subscription) -> Iterator[tuple[bytes, bytes]]:
    """Yield the messages that wait, each with the process that sent it, as in `senders_on`.

    Args:
        subscription: one that no executor takes messages from.
    """
    rcl, utilities = _libraries()
    message = _Bytes(allocator=utilities.rcutils_get_default_allocator())
    information = _Information()
    arguments = (ctypes.byref(message), ctypes.byref(information), None)
    try:
        with subscription.handle:
            while rcl.rcl_take_serialized_message(subscription.handle.pointer, *arguments) == _OK:
                raw = ctypes.string_at(message.buffer, message.length)
                yield raw, bytes(information.publisher)[:_PARTICIPANT]
    finally:
        utilities.rcutils_uint8_array_fini(ctypes.byref(message))


def senders_on(node: Node, topic: str) -> dict[bytes, str]:
    """Return the processes that the graph knows to publish a topic, each with the name of a node that does."""
    publishers: list[Any] = node.get_publishers_info_by_topic(topic)
    return {
        bytes(publisher.endpoint_gid)[
            :_PARTICIPANT
        ]: f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
        for publisher in publishers
    }
