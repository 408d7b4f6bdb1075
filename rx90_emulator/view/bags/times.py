"""Stamps as the page shows them."""

from __future__ import annotations

from rx90_common.base.rates import NANOSECONDS


def since(time_ns: int, origin_ns: int) -> float:
    """Return how long after the origin a stamp is, s: the time that the page shows."""
    return (time_ns - origin_ns) / NANOSECONDS


def seconds(time_ns: int) -> str:
    """Return a time in s, to the ms."""
    return f"{since(time_ns, 0):.3f}"
