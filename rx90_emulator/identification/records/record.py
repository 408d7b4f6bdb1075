"""The joint-side record of one bag, which every step of the identification works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

_WALL_CLOCK = 946_684_800.0  # s, the year 2000: stamps before count from another beginning
_MEDIAN_SAMPLES = 5  # samples in the running median
_OUTLIER_FACTOR = 4.0  # times the 99th percentile of the distances from it
_MIN_SPIKE_SHARE = 0.02  # and this share of the signal's range
_NEIGHBOUR_SHARE = 0.25  # share of a spike's distance that its neighbours stay below


@dataclass(frozen=True)
class BagSource:
    """A bag that estimates rest on.

    Attributes:
        path: the bag.
        sha256: digest of its storage.
        duration: time from the first to the last sample, s.
        missing: messages missing from a steady stream.
        outliers: messages left out because of a NaN, a spike or a repeated stamp.
        begin: stamp of the first sample, s.
    """

    path: Path
    sha256: str
    duration: float
    missing: int
    outliers: int
    begin: float = 0.0

    @property
    def recorded(self) -> str:
        """Return when it was recorded, by its stamps; those of a simulation, and of many a log, tell no date."""
        if self.begin < _WALL_CLOCK:
            return f"no date; stamps from {self.begin:.6g} to {self.begin + self.duration:.6g} s"
        return datetime.fromtimestamp(self.begin, timezone.utc).isoformat(timespec="seconds")


@dataclass(frozen=True, eq=False)
class JointRecord:
    """What the arm did and what the drives gave, at the joints, in one bag.

    Attributes:
        names: n joints.
        time: s, strictly increasing, shape (m,).
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        torque: drive torque at the joint, friction not subtracted, Nm, shape (m, n).
        source: the bag.
        sha256: digest of the bag.
        missing: messages missing from a steady stream.
        outliers: messages left out because of a NaN, a spike or a repeated stamp.

    Raises:
        IdentificationError: if a shape does not fit, a number is not finite, or time does not increase.
    """

    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    torque: Array
    source: Path
    sha256: str
    missing: int = 0
    outliers: int = 0

    def __post_init__(self) -> None:
        shape = (len(self.time), len(self.names))
        for field in ("position", "velocity", "torque"):
            values = getattr(self, field)
            if values.shape != shape:
                raise IdentificationError(f"{self.source}: {field} has shape {values.shape}; accepted: {shape}")
            if not np.isfinite(values).all():
                raise IdentificationError(f"{self.source}: {field} holds NaN or infinity; accepted: finite numbers")
        if len(self.time) == 0:
            raise IdentificationError(f"{self.source}: a record of 0 samples; accepted: one or more")
        back = np.flatnonzero(~(np.diff(self.time) > 0.0))
        if len(back):
            k = int(back[0])
            raise IdentificationError(
                f"{self.source}: time goes from {self.time[k]:.9f} s to {self.time[k + 1]:.9f} s; accepted: increasing"
            )

    @property
    def bag(self) -> BagSource:
        """Return the bag, with the figures of what was read of it."""
        duration = float(self.time[-1] - self.time[0])
        return BagSource(self.source, self.sha256, duration, self.missing, self.outliers, float(self.time[0]))


def check_joints(records: Sequence[JointRecord], names: Sequence[str]) -> None:
    """Refuse a record of other joints than an arm's.

    Raises:
        IdentificationError: naming the bag, its joints and the arm's.
    """
    for record in records:
        if tuple(record.names) != tuple(names):
            raise IdentificationError(
                f"{record.source}: joints {', '.join(record.names)}; accepted: {', '.join(names)}"
            )


def spikes(values: Array) -> NDArray[np.bool_]:
    """Return which rows of samples hold a spike: far from the running median, while both neighbours are not.

    The start of a motion lies far from the median, too, but not for a single sample.

    Args:
        values: shape (m, k).

    Returns:
        Whether any column has one, shape (m,).
    """
    distance = np.abs(values - median_filter(values, size=(_MEDIAN_SAMPLES, 1), mode="nearest"))
    usual = np.percentile(distance, 99.0, axis=0)
    low, high = np.percentile(values, (1.0, 99.0), axis=0)
    far = distance > _OUTLIER_FACTOR * usual + _MIN_SPIKE_SHARE * (high - low) + 1e-9
    beside = np.pad(distance, ((1, 1), (0, 0)))
    return np.asarray(
        (far & (_NEIGHBOUR_SHARE * distance > beside[:-2]) & (_NEIGHBOUR_SHARE * distance > beside[2:])).any(axis=1)
    )
