"""Read a sensor_msgs/JointState from CDR bytes of any layout, and say clearly what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.errors import ExchangeError
from rx90_common.base.quoting import quoted
from rx90_common.exchange.cdr_reader import CdrReader

Arrays = tuple[NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.float64] | None]


def parse_joint_state(raw: bytes, names: Sequence[str]) -> tuple[int, Arrays]:
    """Return stamp_ns and (position, velocity, effort) in the order of `names`, None for an empty array.

    Raises:
        ExchangeError: see `JointStateCodec.decode`.
    """
    reader = CdrReader(raw)
    stamp_ns = reader.stamp_ns()
    reader.string("header.frame_id")
    found = [reader.string(f"name[{i}]") for i in range(reader.count("name", least_bytes=4))]
    order = _order(found, names)
    position, velocity, effort = (
        _pick(reader.doubles(field), order, field, names) for field in ("position", "velocity", "effort")
    )
    reader.finish()
    return stamp_ns, (position, velocity, effort)


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
