"""Read one bag or table into the joint-side record that every step of the identification works on.

record = read_record("bag", layout)
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import FIELDS
from rx90_common.base.arrays import Array, Index, Mask, interpolated
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_emulator.identification.robot import BagLayout

_WALL_CLOCK = 946_684_800.0  # s, the year 2000: earlier stamps do not count from 1970
_MEDIAN_SAMPLES = 5  # samples in the running median by which spikes are found
# of the 99th percentile of the distances from it, and of the range
_OUTLIER_FACTOR = 4.0
_MIN_SPIKE_SHARE = 0.02
_NEIGHBOUR_SHARE = 0.25  # share of a spike's distance that its neighbours stay below
_BANDWIDTH_HZ = 40.0  # Hz, of velocities differentiated from positions
_MAX_VELOCITY_RATIO = 2.0  # largest ratio between a velocity and the change of its position
# s of a comparison of the two; rad/s, RMS, below which they are not compared
_COMPARED_S = 0.1
_COMPARED_SPEED = 1e-2
_UNITS = {
    180.0 / math.pi: ", so it looks like deg/s",
    math.pi / 180.0: ", so the position looks like deg",
    30.0 / math.pi: ", so it looks like rpm",
    1e3: ", so the time looks like ms",
    1e6: ", so the time looks like us",
    1e9: ", so the time looks like ns",
}
"""What a velocity over the change of a position, without these units, looks like."""
_MIN_DISTINCT_VELOCITIES = 1000  # distinct velocities, below which they count as quantised
_MAX_VALUE = 1e9  # rad, rad/s, Nm or A
_STORAGE = (".mcap", ".db3", ".bag")


@dataclass(frozen=True)
class BagSource:
    """A bag that estimates were made from.

    Attributes:
        path: the bag.
        sha256: digest of its storage.
        duration: time from the first to the last sample, s.
        outliers: messages left out because of a NaN, a spike or a repeated stamp.
        begin: stamp of the first sample, s.
        unit: of the torques: Nm, or A where they are currents without torque constants.
    """

    path: Path
    sha256: str
    duration: float
    outliers: int = 0
    begin: float = 0.0
    unit: str = "Nm"

    @property
    def recorded(self) -> str:
        """Return when it was recorded, by its stamps; empty if these give no date, as in simulations and many logs."""
        if self.begin < _WALL_CLOCK:
            return f"no date; stamps from {self.begin:.6g} to {self.begin + self.duration:.6g} s"
        return datetime.fromtimestamp(self.begin, timezone.utc).isoformat(timespec="seconds")


_CONTENT_STEP = 1e-6  # rad and Nm: samples that were rounded to fewer digits still compare as equal
_CONTENT_ROWS = 3  # successive samples that do not agree by chance
_HASH_SEED = 7


class Content(NamedTuple):
    """The content of a log whatever its name, stamps and format, to find what two logs have in common.

    Attributes:
        marks: a hash of the few samples from each sample on, equal where positions and efforts are equal, shape (m,).
        travel: of the joints over these samples, rad, shape (m,).
    """

    marks: NDArray[np.uint64]
    travel: Array

    @classmethod
    def of(cls, position: Array, effort: Array) -> Content:
        """Return the content for positions and efforts as logged, each of shape (m, n)."""
        numbers = (
            np.rint(np.hstack([position, effort]) / _CONTENT_STEP)
            .astype(np.int64)
            .astype(np.uint64)
        )
        factor = np.random.default_rng(_HASH_SEED).integers(
            1, 2**63, (_CONTENT_ROWS, numbers.shape[1]), np.uint64
        )
        count = max(0, len(numbers) - _CONTENT_ROWS + 1)
        marks = np.zeros(count, np.uint64)
        for k, row in enumerate(factor):
            marks += (numbers[k : k + count] * row).sum(axis=1, dtype=np.uint64)
        travel = np.abs(np.diff(position, axis=0, prepend=position[:1])).sum(axis=1)
        return cls(marks, travel[:count])

    def shared(self, other: Content) -> float:
        """Return the share of its travel that another log contains, too."""
        common = self.travel[np.isin(self.marks, other.marks)]
        return float(common.sum() / max(self.travel.sum(), 1e-300))


@dataclass(frozen=True, eq=False)
class JointRecord:
    """Motion and drive torques at the joints in one bag; all numbers are finite.

    Attributes:
        names: n joints.
        time: s, strictly increasing, shape (m,).
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        torque: drive torque at the joint, friction not subtracted, Nm, shape (m, n).
        source: the bag.
        sha256: digest of the bag.
        outliers: messages left out because of a NaN, a spike or a repeated stamp.
        alarms: what looks wrong in the log and was mended, a sentence each.
        content: for the comparison with other logs; None for a record that was not read from a file.
        unit: of the torques, as in BagSource.
    """

    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    torque: Array
    source: Path
    sha256: str
    outliers: int = 0
    alarms: tuple[str, ...] = ()
    content: Content | None = None
    unit: str = "Nm"

    def of_joints(self, names: Sequence[str]) -> JointRecord:
        """Return the record with all its joints in another order."""
        place = [self.names.index(name) for name in names]
        values = {
            field: getattr(self, field)[:, place] for field in ("position", "velocity", "torque")
        }
        return replace(self, names=tuple(names), **values)

    @cached_property
    def period(self) -> float:
        """Return the usual time between two samples, s; 0 for a single one."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    @property
    def bag(self) -> BagSource:
        """Return the bag with the figures of its reading."""
        begin = float(self.time[0])
        return BagSource(
            self.source, self.sha256, float(self.time[-1]) - begin, self.outliers, begin, self.unit
        )


_REST_SPEED = 0.05  # rad/s, and share of the fastest joint's speed: below both a joint rests


def moving(velocity: Array) -> Mask:
    """Return which joints do not rest throughout, shape (n,), by their velocities, rad/s, shape (m, n)."""
    if not len(velocity):
        return np.zeros(velocity.shape[1], np.bool_)
    usual = np.quantile(np.abs(velocity), 0.9, axis=0)
    return np.asarray(usual > _REST_SPEED * np.clip(usual.max(initial=0.0), 1e-3, 1.0))


def block_means(values: NDArray[Any], size: int) -> Array:
    """Return the means of so many rows each, shape (m, ...) to (m // size, ...); white noise stays white."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1))


def stretches(there: Mask) -> list[tuple[int, int]]:
    """Return begin and end (exclusive) of each stretch of samples that meet a condition, shape (m,)."""
    edges = np.flatnonzero(np.diff(there, prepend=False, append=False))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def in_unit(text: str, unit: str) -> str:
    """Return a text with the units of torques, and of values made from them, for torques in another unit than Nm."""
    if unit == "Nm":
        return text
    units = (("Nm", ""), (r"kg m(?:\^2|²)", " s^2"), ("kg m", " s^2/m"), ("kg", " s^2/m^2"))
    for si, other in units:
        text = re.sub(rf"\b{si}(?![\w^])", f"{unit}{other}", text)
    return text


def spikes(values: Array) -> Mask:
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
    padded = np.pad(distance, ((1, 1), (0, 0)))
    alone = _NEIGHBOUR_SHARE * distance > np.maximum(padded[:-2], padded[2:])
    return np.asarray((far & alone).any(axis=1))


def digest(path: Path | str) -> str:
    """Return the SHA-256 of a bag: of its storage files one after the other, without metadata.yaml."""
    path = Path(path)
    files = (
        sorted(file for file in path.iterdir() if file.suffix in _STORAGE)
        if path.is_dir()
        else [path]
    )
    whole = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                whole.update(block)
    return whole.hexdigest()


def read_record(
    path: Path | str, layout: BagLayout, rate: float | None = None, *, currents: bool = False
) -> JointRecord:
    """Read one bag.

    Messages with a NaN and spikes of a single sample are left out and counted. Velocities come from the messages; where
    these carry none or quantised ones, positions are differentiated by a zero-phase filter.

    Args:
        path: a rosbag2 folder, an .mcap or .db3 file, a ROS 1 .bag file, or a table.
        layout: what the messages hold.
        rate: if given, block means of as many samples as leave about this rate, Hz.
        currents: whether efforts in A without torque constants are taken as they are.
    """
    path = Path(path)
    names = (*layout.messages, *layout.followed)
    count = len(layout.messages)
    series = read_joint_states(
        path, layout.topic, names, record_time=layout.record_time, mapping=layout.mapping
    )
    if layout.followed and series.effort is not None:  # whatever it is
        series = replace(series, effort=np.where(np.arange(len(names)) < count, series.effort, 0.0))
    where = f"{path}: {series.topic}"
    unit = _unit(where, series, layout, currents=currents)
    good = _good_rows(where, series)
    time = series.stamp_ns[good] / NANOSECONDS
    fields = {name: values[good] for name, values in series.fields.items()}
    _check_sizes(where, fields)
    alarms = []
    new = repeated_samples(fields["position"])
    if new is not None:
        alarms.append(_repeated_text(new, time))
        time = time[new]
        fields = {name: values[new] for name, values in fields.items()}
    if layout.turns is None:
        alarms += _unwrap(names, time, fields["position"])
    fields["velocity"] = _velocity(where, names, time, fields)
    content = Content.of(fields["position"], fields["effort"])
    if layout.torque_delay:
        acted = time - layout.torque_delay
        fields["effort"] = interpolated(acted, time, fields["effort"])
    joints = layout.joint_side({name: values[:, :count] for name, values in fields.items()})
    size = 1
    if rate is not None and len(time) > 1:
        recorded = (len(time) - 1) / (time[-1] - time[0])
        size = max(1, round(recorded / rate))
    means = {
        name: block_means(np.hstack([joints[name], fields[name][:, count:]]), size)
        for name in FIELDS
    }
    return JointRecord(
        names=(*layout.names, *layout.followed),
        time=block_means(time, size),
        position=means["position"],
        velocity=means["velocity"],
        torque=means["effort"],
        source=path,
        sha256=digest(path),
        outliers=len(series.stamp_ns) - len(good),
        alarms=tuple(f"{path}: {alarm}" for alarm in alarms),
        content=content,
        unit=unit,
    )


def _unit(where: str, series: JointSeries, layout: BagLayout, *, currents: bool) -> str:
    """Return the unit of the torques; refuse logs without positions or efforts."""
    for name in ("position", "effort"):
        values = series.fields.get(name)
        if values is None or np.isnan(values).all():
            raise IdentificationError(f"{where} carries no {name}; accepted: position and effort")
    if not np.nan_to_num(series.fields["effort"]).any():
        raise IdentificationError(
            f"{where} carries effort 0 throughout; accepted: measured efforts"
        )
    unit = series.units["effort"]
    if unit == "Nm" or (unit == "A" and layout.torque_constant is not None):
        return "Nm"
    if unit == "A" and currents:
        return "A"
    raise IdentificationError(
        f"{where}: its efforts are in {plain(unit)}; accepted: Nm, or A with --torque-constant"
    )


def _check_sizes(where: str, fields: Mapping[str, Array]) -> None:
    """Refuse numbers that no joint reaches, and efforts so small that their squares are none."""
    for name, values in fields.items():
        most = float(np.abs(values).max(initial=0.0))
        least = 1.0 / _MAX_VALUE if name == "effort" else 0.0
        if most > _MAX_VALUE or 0.0 < most < least:
            accepted = f"{least:g} to {_MAX_VALUE:g}" if least else f"up to {_MAX_VALUE:g}"
            raise IdentificationError(
                f"{where}: the largest {name} is {most:.3g}; accepted: {accepted}"
            )


def _velocity(where: str, names: Sequence[str], time: Array, fields: Mapping[str, Array]) -> Array:
    """Return the velocities of a log, differentiated positions where it has none of a joint or coarse ones."""
    position = fields["position"]
    if "velocity" not in fields:
        return _differentiated(time, position)
    velocity = fields["velocity"].copy()
    fewest = min(_MIN_DISTINCT_VELOCITIES, len(time) / 4)
    poor = [k for k, column in enumerate(velocity.T) if len(np.unique(column)) < fewest]
    velocity[:, poor] = _differentiated(time, position[:, poor])
    _check_velocity(where, names, time, position, velocity)
    return velocity


def _good_rows(where: str, series: JointSeries) -> Index:
    """Return the rows without NaN, spike or repeated stamp; refuse stamps that go back."""
    stamp = series.stamp_ns / NANOSECONDS
    steps = np.diff(series.stamp_ns)
    wrong = ""
    back = np.flatnonzero(steps < 0)
    if len(steps) and not steps.any():
        wrong = f"every stamp is {stamp[0]:.9f} s"
    elif len(back):
        wrong = f"the stamp goes back from {stamp[back[0]]:.9f} s to {stamp[back[0] + 1]:.9f} s"
    if wrong:
        raise IdentificationError(
            f"{where}: {wrong}; accepted: increasing stamps, or record_time: true in a signal map"
        )
    finite = [np.isfinite(values).all(axis=1) for values in series.fields.values()]
    rows = np.flatnonzero(np.append(True, steps > 0) & np.all(finite, axis=0))
    if len(rows) == 0:
        raise IdentificationError(f"{where} carries no message with finite numbers alone")
    spoilt = spikes(series.fields["position"][rows]) | spikes(series.fields["effort"][rows])
    return rows[~spoilt]


# of an encoder between samples, above which it moves too fast to repeat a position
_LEAST_STEPS = 5.0


def repeated_samples(position: Array) -> Mask | None:
    """Return which samples are new where each position is repeated, as in a log faster than its source, else None.

    Where the arm rests, as many samples are kept.

    Args:
        position: shape (m, n).
    """
    steps = np.abs(np.diff(position, axis=0))
    changed = np.append(True, steps.any(axis=1))
    lengths = np.diff(np.flatnonzero(changed))
    if len(lengths) < 2 or np.median(lengths) < 2.0:
        return None
    least = np.min(steps, axis=0, where=steps > 0.0, initial=np.inf)
    if np.median((steps[changed[1:]] / least).max(axis=1)) < _LEAST_STEPS:
        return None
    count = np.arange(len(changed))
    since = count - np.maximum.accumulate(np.where(changed, count, 0))
    return np.asarray(since % math.ceil(1.5 * float(np.median(lengths))) == 0)


def _repeated_text(new: Mask, time: Array) -> str:
    lasting = float(time[-1] - time[0])
    return (
        f"the positions change {np.count_nonzero(new) / lasting:.3g} times a second, in {len(time) / lasting:.3g} "
        "samples; the first sample with each is used; accepted: a log with a new position in each sample"
    )


def _unwrap(names: Sequence[str], time: Array, position: Array) -> Iterator[str]:
    """Continue positions, in place, where they jump by whole turns from a sample to the next; yield what was done."""
    steps = np.diff(time)
    near = steps < 3.5 * np.median(steps) if len(steps) else np.zeros(0, np.bool_)
    for name, column in zip(names, position.T, strict=True):
        turns = np.where(near, np.rint(np.diff(column) / math.tau), 0.0)
        jumps = np.flatnonzero(turns)
        if len(jumps):
            first = int(jumps[0]) + 1
            column[1:] -= math.tau * np.cumsum(turns)
            yield (
                f"the position of {quoted(name)} jumps by 2 pi at sample {first}, {time[first] - time[0]:.6g} s after "
                f"the first, and {len(jumps)} times in all; it is continued; accepted: positions that do not wrap"
            )


def _differentiated(time: Array, position: Array) -> Array:
    """Return velocities by a zero-phase filter, shape (m, k)."""
    if len(time) < 2 or position.shape[1] == 0:
        return np.zeros_like(position)
    period = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + period / 2.0, period)
    smooth = interpolated(even, time, position)
    if 0.4 / period > _BANDWIDTH_HZ and len(even) > 30:
        smooth = sosfiltfilt(
            butter(2, _BANDWIDTH_HZ, fs=1.0 / period, output="sos"), smooth, axis=0
        )
    slope = np.gradient(smooth, period, axis=0)
    return interpolated(time, even, slope)


def _check_velocity(
    where: str, names: Sequence[str], time: Array, position: Array, velocity: Array
) -> None:
    """Refuse velocities whose integrals over a window differ from the change of position in size or sign."""
    size = max(1, round(_COMPARED_S * (len(time) - 1) / max(time[-1] - time[0], 1e-9)))
    edges = np.arange(0, len(time), size)
    travelled = cumulative_trapezoid(velocity, time, axis=0, initial=0)
    lasting = np.diff(time[edges])
    # no gap in it
    whole = lasting < 2.0 * np.median(lasting) if len(lasting) else np.zeros(0, dtype=np.bool_)
    distance = np.diff(position[edges], axis=0)[whole]
    integral = np.diff(travelled[edges], axis=0)[whole]
    power = (distance**2).sum(axis=0)
    for k in np.flatnonzero(power > len(distance) * (_COMPARED_SPEED * _COMPARED_S) ** 2).tolist():
        factor = float(distance[:, k] @ integral[:, k] / power[k])
        if not 1.0 / _MAX_VELOCITY_RATIO < factor < _MAX_VELOCITY_RATIO:
            looks = next((text for unit, text in _UNITS.items() if 0.9 < factor / unit < 1.1), "")
            raise IdentificationError(
                f"{where}: the velocity of {quoted(names[k])} is {factor:.3g} times the change of its position{looks}; "
                "accepted: s, rad and rad/s, of the same sign"
            )
