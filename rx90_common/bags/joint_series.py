"""A recorded topic of joint states as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.topics import FIELDS, quantities
from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS

Int64Array = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class JointSeries:
    """n messages of k joints, in the order of the bag's log time.

    Attributes:
        topic: absolute topic name.
        names: k joint names.
        stamp_ns: header.stamp in ns, int64 of shape (n,).
        position: rad, float64 of shape (n, k); None if the messages contain none.
        velocity: rad/s, as position.
        effort: Nm, or `effort_unit`; as position.
        effort_unit: of effort if it differs from the usual unit of the topic's name, such as A.

    Raises:
        BagError: if names repeat, an array has another shape or type.
    """

    topic: str
    names: tuple[str, ...]
    stamp_ns: Int64Array
    position: Array | None = None
    velocity: Array | None = None
    effort: Array | None = None
    effort_unit: str = ""

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            raise BagError(
                f"{self.topic}: joint names {', '.join(self.names)}; accepted: each name once"
            )
        if self.stamp_ns.ndim != 1 or self.stamp_ns.dtype != np.int64:
            found = f"{self.stamp_ns.dtype} of shape {self.stamp_ns.shape}"
            raise BagError(f"{self.topic}: stamp_ns is {found}; accepted: int64 (n,)")
        shape = (len(self.stamp_ns), len(self.names))
        for field, values in self.fields.items():
            if values.shape != shape or values.dtype != np.float64:
                found = f"{values.dtype} of shape {values.shape}"
                raise BagError(f"{self.topic}: {field} is {found}; accepted: float64 {shape}")

    @property
    def fields(self) -> dict[str, Array]:
        """Return the arrays that are there, by field name."""
        return {field: values for field in FIELDS if (values := getattr(self, field)) is not None}

    @property
    def quantities(self) -> dict[str, str]:
        """Return each field's quantity and unit, such as `position [rad]`; friction_states have other names."""
        return {
            field: f"{name} [{unit}]"
            for field, (name, unit) in quantities(self.topic, self.effort_unit).items()
        }

    @property
    def units(self) -> dict[str, str]:
        """Return the unit of each field."""
        return {
            field: unit for field, (_, unit) in quantities(self.topic, self.effort_unit).items()
        }

    @property
    def time(self) -> Array:
        """Return header.stamp in s, float64 of shape (n,)."""
        return np.asarray(self.stamp_ns / NANOSECONDS, dtype=np.float64)

    def take(self, rows: Index | Mask | slice) -> JointSeries:
        """Return the series of these messages (an index, a mask or a slice)."""
        fields: dict[str, Any] = {field: values[rows] for field, values in self.fields.items()}
        return replace(self, stamp_ns=self.stamp_ns[rows], **fields)

    def select(self, names: Sequence[str]) -> JointSeries:
        """Return the series of these joints, in this order.

        Raises:
            BagError: if a joint is not there.
        """
        for name in names:
            if name not in self.names:
                raise BagError(
                    f"{self.topic}: no joint {quoted(name)}; there are {', '.join(self.names)}"
                )
        columns = [self.names.index(name) for name in names]
        fields: dict[str, Any] = {
            f: np.ascontiguousarray(values[:, columns]) for f, values in self.fields.items()
        }
        return replace(self, names=tuple(names), **fields)
