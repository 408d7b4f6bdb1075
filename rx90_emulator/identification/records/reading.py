"""Read the recorded joint states of any robot as a joint-side record; needs no ROS.

record = read_record("bag", BagLayout.rx90("motor_states", setup))
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_emulator.identification.records.layout import BagLayout
from rx90_emulator.identification.records.record import JointRecord, spikes

_BANDWIDTH_HZ = 40.0  # Hz, of velocities differentiated from positions
_MAX_VELOCITY_RATIO = 2.0  # largest ratio between a velocity and the change of its position
_COMPARED_S = 0.1  # s, over which they are compared
_REST_SPEED = 1e-2  # rad/s, RMS, below which they are not compared
_MIN_DISTINCT_VELOCITIES = 1000  # distinct velocities, below which they count as quantised
_MAX_VALUE = 1e9  # rad, rad/s, Nm or A
_STORAGE = (".mcap", ".db3", ".bag")


def read_record(path: Path | str, layout: BagLayout, rate: float | None = None) -> JointRecord:
    """Read one bag.

    Messages with a NaN and spikes of a single sample are left out and counted; messages that are missing in a steady
    stream are counted, too. Velocities come from the messages; where these carry none or quantised ones, positions are
    differentiated by a zero-phase filter.

    Args:
        path: a rosbag2 folder, an .mcap or .db3 file, or a ROS 1 .bag file.
        layout: what the messages hold.
        rate: if given, block means of as many samples as leave about this rate, Hz.

    Raises:
        BagError: if the bag cannot be read, is empty, or has no such topic or names.
        IdentificationError: if positions or efforts are missing or of a size that no joint reaches, time stamps go
            back, or velocities are not those of the positions.
    """
    path = Path(path)
    series = read_joint_states(
        path, layout.topic, layout.messages, record_time=layout.record_time, mapping=layout.mapping
    )
    position, effort = _required(path, series, "position"), _required(path, series, "effort")
    unit = series.units["effort"]
    if unit != "Nm" and (unit != "A" or layout.torque_constant is None):
        raise IdentificationError(
            f"{path}: {series.topic}: its efforts are in {plain(unit)}; accepted: Nm, or A with --torque-constant"
        )
    kept = _good_rows(path, series, position, effort)
    time = series.stamp_ns[kept] / NANOSECONDS
    missing = _missing(series.time)
    velocity = None if series.velocity is None else series.velocity[kept]
    position, effort = position[kept], effort[kept]
    for name, values in (("position", position), ("velocity", velocity), ("effort", effort)):
        _check_size(path, series, name, values)
    if layout.torque_constant is not None:
        effort = effort * layout.torque_constant
    if velocity is None:
        velocity = _velocity(time, position)
    else:
        poor = [
            k
            for k in range(len(layout.names))
            if len(np.unique(velocity[:, k])) < min(_MIN_DISTINCT_VELOCITIES, len(time) / 4)
        ]
        velocity[:, poor] = _velocity(time, position[:, poor])
        _check_velocity(path, layout, time, position, velocity)
    if layout.turns is not None:
        inverse = np.linalg.inv(layout.turns)
        position, velocity, effort = position @ inverse.T, velocity @ inverse.T, effort @ layout.turns
    if layout.zero is not None:
        position = position - layout.zero
    if rate is not None:
        time, position, velocity, effort = _block_means(time, position, velocity, effort, rate)
    outliers = len(series.stamp_ns) - len(kept)
    return JointRecord(layout.names, time, position, velocity, effort, path, digest(path), missing, outliers)


def digest(path: Path | str) -> str:
    """Return the SHA-256 of a bag: of its storage files one after the other, without metadata.yaml."""
    path = Path(path)
    files = sorted(file for file in path.iterdir() if file.suffix in _STORAGE) if path.is_dir() else [path]
    whole = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                whole.update(block)
    return whole.hexdigest()


def _required(path: Path, series: JointSeries, field: str) -> Array:
    values: Array | None = getattr(series, field)
    if values is None or np.isnan(values).all():
        raise IdentificationError(f"{path}: {series.topic} carries no {field}; accepted: position and effort")
    if field == "effort" and not np.nan_to_num(values).any():
        raise IdentificationError(f"{path}: {series.topic} carries effort 0 throughout; accepted: measured efforts")
    return values


def _check_size(path: Path, series: JointSeries, name: str, values: Array | None) -> None:
    """Refuse numbers that no joint reaches, and efforts so small that their squares are none."""
    most = 0.0 if values is None else float(np.abs(values).max(initial=0.0))
    if most > _MAX_VALUE or (name == "effort" and 0.0 < most < 1.0 / _MAX_VALUE):
        least = f"{1.0 / _MAX_VALUE:g} to " if name == "effort" else "up to "
        raise IdentificationError(
            f"{path}: {series.topic}: the largest {name} is {most:.3g}; accepted: {least}{_MAX_VALUE:g}"
        )


def _good_rows(path: Path, series: JointSeries, position: Array, effort: Array) -> NDArray[np.intp]:
    """Return the rows without NaN, spike or repeated stamp; refuse stamps that go back."""
    steps = np.diff(series.stamp_ns)
    if len(steps) and not steps.any():
        raise IdentificationError(
            f"{path}: {series.topic}: every stamp is {series.stamp_ns[0] / NANOSECONDS:.9f} s; accepted: increasing "
            "stamps, or --record-time"
        )
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0])
        raise IdentificationError(
            f"{path}: {series.topic}: the stamp goes back from {series.stamp_ns[k] / NANOSECONDS:.9f} s "
            f"to {series.stamp_ns[k + 1] / NANOSECONDS:.9f} s; accepted: increasing stamps, or --record-time"
        )
    good = np.append(True, steps > 0)
    for values in (position, effort, series.velocity):
        if values is not None:
            good &= np.isfinite(values).all(axis=1)
    rows = np.flatnonzero(good)
    if len(rows) == 0:
        raise IdentificationError(f"{path}: {series.topic} carries no message with finite numbers alone")
    return np.asarray(rows[~(spikes(position[rows]) | spikes(effort[rows]))])


def _missing(time: Array) -> int:
    """Return how many messages are missing from a steady stream."""
    steps = np.diff(time)
    if not len(steps):
        return 0
    period = float(np.median(steps))
    in_gaps = float(np.sum(np.maximum(np.rint(steps / period) - 1.0, 0.0)))
    # Jitter makes gaps without a loss; an error of the median period makes losses without a gap.
    return int(min(in_gaps, max(0.0, np.rint((time[-1] - time[0]) / period) - np.count_nonzero(steps))))


def _velocity(time: Array, position: Array) -> Array:
    """Return velocities by a zero-phase filter, shape (m, k)."""
    if len(time) < 2 or position.shape[1] == 0:
        return np.zeros_like(position)
    period = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + period / 2.0, period)
    smooth = np.column_stack([np.interp(even, time, column) for column in position.T])
    if 0.4 / period > _BANDWIDTH_HZ and len(even) > 30:
        smooth = sosfiltfilt(butter(2, _BANDWIDTH_HZ, fs=1.0 / period, output="sos"), smooth, axis=0)
    slope = np.gradient(smooth, period, axis=0)
    return np.column_stack([np.interp(time, even, column) for column in slope.T])


def _check_velocity(path: Path, layout: BagLayout, time: Array, position: Array, velocity: Array) -> None:
    """Refuse velocities whose integrals over a window differ from the change of position in size or sign."""
    size = max(1, round(_COMPARED_S * (len(time) - 1) / max(time[-1] - time[0], 1e-9)))
    edges = np.arange(0, len(time), size)
    travelled = cumulative_trapezoid(velocity, time, axis=0, initial=0)
    lasting = np.diff(time[edges])
    whole = lasting < 2.0 * np.median(lasting) if len(lasting) else np.zeros(0, dtype=np.bool_)  # no gap in it
    distance, integral = (np.diff(values[edges], axis=0)[whole] for values in (position, travelled))
    power = (distance**2).sum(axis=0)
    for k in np.flatnonzero(power > len(distance) * (_REST_SPEED * _COMPARED_S) ** 2).tolist():
        factor = float(distance[:, k] @ integral[:, k] / power[k])
        if not 1.0 / _MAX_VELOCITY_RATIO < factor < _MAX_VELOCITY_RATIO:
            raise IdentificationError(
                f"{path}: {layout.topic}: the velocity of {quoted(layout.messages[k])} is {factor:.3g} times the "
                "change of its position; accepted: rad and rad/s, of the same sign"
            )


def _block_means(time: Array, position: Array, velocity: Array, effort: Array, rate: float) -> tuple[Array, ...]:
    """Return block means of as many samples as leave about `rate`, Hz."""
    size = round((len(time) - 1) / (time[-1] - time[0]) / rate) if len(time) > 1 else 1
    if size <= 1:
        return time, position, velocity, effort
    count = len(time) // size

    def mean(values: Array) -> Array:
        return np.asarray(values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1))

    return mean(time), mean(position), mean(velocity), mean(effort)
