"""One ramp test as data: from a rig or a CSV file; its sliding part.

Useless ramps are refused here, by `first_motion` and `sliding_window`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, Rx90Error
from rx90_common.base.quoting import counted, quoted
from rx90_common.base.text_lines import read_lines
from rx90_common.process.files import atomic_files

CSV_COLUMNS = ("time", "counts", "torque", "measured_torque")
MOVED_COUNTS = 2.0
MOVED_SHARE = 1e-3
"""Break-away is certain after two counts (one may be jitter at an edge) and this share of the ramp's angle
(presliding moves the shaft a little before)."""
SLIDING_COUNTS = 10.0
SLIDING_ANGLE = 0.1
"""The shaft slides after both of these, counts and rad at the motor: presliding ends within one or two counts of a
coarse encoder, and within some mrad of the joint."""
MIN_READINGS = 15
"""Least number of readings of a sliding shaft from which friction and inertia can be estimated."""
ONSET_TICKS = 5
"""Break-away is fitted to this many readings after the first certain motion."""
EARLIER_TICKS = 25
"""It is sought in this many readings before that."""


class RampModel(NamedTuple):
    """Equation 3 under a ramp torque in closed form, one side of the gear: J w' = m t - f_v w - f_c sgn w.

    Friction f_c in Nm and f_v in Nm s/rad, inertia J in kg m², slope m in Nm/s. Break-away at t_b = (f_c + f_r) / m,
    where f_r, Nm, is by how much static friction exceeds f_c; with s = t - t_b, the time constant T = J / f_v and
    a = m / f_v,
        w(t) = a s + (f_r / f_v - a T) (1 - exp(-s / T)),
    with the asymptote a t - b, b = a (f_c / m + T) = f_c / f_v + J m / f_v^2, which does not depend on f_r.
    """

    coulomb: float
    viscous: float
    inertia: float
    slope: float
    release: float = 0.0

    @property
    def break_away_time(self) -> float:
        """Return (f_c + f_r) / m, s."""
        return (self.coulomb + self.release) / self.slope

    @property
    def time_constant(self) -> float:
        """Return J / f_v, s."""
        return self.inertia / self.viscous

    def velocity(self, time: ArrayLike) -> Array:
        """Return w(t), rad/s."""
        s, T, a = self._since_release(time)
        return np.asarray(a * s - (self.release / self.viscous - a * T) * np.expm1(-s / T))

    def angle(self, time: ArrayLike) -> Array:
        """Return the angle since rest, rad."""
        s, T, a = self._since_release(time)
        return np.asarray(
            a * s * s / 2 + (self.release / self.viscous - a * T) * (s + T * np.expm1(-s / T))
        )

    def _since_release(self, time: ArrayLike) -> tuple[Array, float, float]:
        """Return s, s, T, s, and a, rad/s²."""
        s = np.maximum(np.asarray(time, dtype=np.float64) - self.break_away_time, 0.0)
        return s, self.time_constant, self.slope / self.viscous


class RecordError(Rx90Error):
    """A file does not hold a ramp test that can be used, or a folder is not one for a new measurement."""


@dataclass(frozen=True)
class RampRecord:
    """One ramp, motor side.

    Attributes:
        time: of each reading, s, increasing, shape (n,).
        angle: of the motor, rad, cumulative, shape (n,).
        slope: m of tau = m t, Nm/s.
        angle_step: angle of an encoder count, rad.
        torque: commanded torque held from each reading to the next, Nm, shape (n,), None if unknown.
        measured_torque: by the current, Nm, shape (n,), None if unknown.
        loaded: the revolute joint was coupled.
        label: names the ramp in messages and plots.
    """

    time: Array
    angle: Array
    slope: float
    angle_step: float
    torque: Array | None = None
    measured_torque: Array | None = None
    loaded: bool = False
    label: str = "ramp"

    def __post_init__(self) -> None:
        if self.time.ndim != 1 or self.time.size < 2 or self.time.shape != self.angle.shape:
            raise RecordError(
                f"{self.label}: {counted(self.time.size, 'reading')}; accepted: at least 2"
            )
        for name in ("time", "angle", "torque", "measured_torque"):
            values = getattr(self, name)
            if values is not None and not (
                values.shape == self.time.shape and np.isfinite(values).all()
            ):
                raise RecordError(
                    f"{self.label}: column {name} holds values that are missing or not finite"
                )
        steps = np.diff(self.time)
        if steps.min() <= 0.0:
            row = int(np.argmin(steps)) + 2
            raise RecordError(f"{self.label}: time does not increase at reading {row}")

    @cached_property
    def tick(self) -> float:
        """Return the usual time between readings, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def origin(self) -> float:
        """Return the time at which the line through the commanded torques is zero, s.

        The command is a staircase, held from reading to reading; the ramp is the line through its middles.
        Without commanded torques it is the time axis's own zero.
        """
        if self.torque is None:
            return 0.0
        rising = self.torque > 0.0
        if rising.sum() < 2:
            raise RecordError(f"{self.label}: the commanded torque never rises")
        middle = self.time[rising] + self.tick / 2
        return float(np.mean(middle - self.torque[rising] / self.slope))


def read_csv(path: Path, slope: float, angle_step: float, loaded: bool = False) -> RampRecord:
    """Read a CSV file with a header of `time` (s) and `counts`, and perhaps `torque`, `measured_torque` (Nm).

    Lines that start with # are comments.

    Raises:
        ConfigError, RecordError: naming the line of what cannot be used.
    """
    rows = []
    for number, line in enumerate(read_lines(path), 1):
        fields = [field.strip(' "\n') for field in line.split(",")]
        if any(fields) and not line.startswith("#"):
            rows.append((number, fields))
    header = rows.pop(0)[1] if rows else []
    for name in CSV_COLUMNS[:2]:
        if name not in header:
            lacking = f"column {quoted(name)} is missing, found {quoted(', '.join(header)[:80])}"
            raise RecordError(f"{path}: {lacking}; accepted: {', '.join(CSV_COLUMNS)}")
    table = []
    for number, fields in rows:
        try:
            values = [float(field) for field in fields]
        except ValueError:
            values = []
        if len(values) != len(header):
            holds = f"line {number} holds {quoted(', '.join(fields)[:80])}"
            raise RecordError(f"{path}: {holds}; accepted: {counted(len(header), 'number')}")
        table.append(values)
    columns = dict(zip(header, np.array(table).reshape(-1, len(header)).T, strict=True))
    return RampRecord(
        time=columns["time"],
        angle=columns["counts"] * angle_step,
        slope=slope,
        angle_step=angle_step,
        torque=columns.get("torque"),
        measured_torque=columns.get("measured_torque"),
        loaded=loaded,
        label=path.name,
    )


def write_csv(record: RampRecord, path: Path) -> None:
    """Write a record so that `read_csv` gives it back."""
    counts = np.rint(record.angle / record.angle_step)
    columns = record.time, counts, record.torque, record.measured_torque
    known = {
        name: column
        for name, column in zip(CSV_COLUMNS, columns, strict=True)
        if column is not None
    }
    header = f"# {record.label}, slope {record.slope!r} Nm/s\n{','.join(known)}"
    with atomic_files(path) as (temporary,):
        # %s is the shortest text that gives a number back
        formats = ["%d" if name == "counts" else "%s" for name in known]
        table = np.column_stack([*known.values()])
        np.savetxt(temporary, table, formats, ",", header=header, comments="", encoding="utf-8")


class SlidingWindow(NamedTuple):
    """The readings of one ramp from where the shaft slides.

    Attributes:
        time: since the torque's zero, s, shape (n,).
        angle: since the ramp's start, rad, shape (n,).
        torque: commanded, held from each reading to the next, Nm, shape (n,).
    """

    record: RampRecord
    time: Array
    angle: Array
    torque: Array


def sliding_window(record: RampRecord) -> SlidingWindow:
    """Return where the shaft slides."""
    time, angle, _ = first_motion(record)
    slides = max(SLIDING_COUNTS * record.angle_step, SLIDING_ANGLE)
    first = _stays_beyond(angle, max(slides, MOVED_SHARE * angle[-1]))
    if time.size - first < MIN_READINGS:
        raise IdentificationError(
            f"{record.label}: {time.size - first} readings of a sliding shaft; "
            f"accepted: at least {MIN_READINGS}; take a slower ramp or a higher end torque"
        )
    torque = record.torque if record.torque is not None else record.slope * (time + record.tick / 2)
    return SlidingWindow(record, time[first:], angle[first:], torque[first:])


def break_away(record: RampRecord, asymptote: tuple[float, float], T: float | None) -> float:
    """Return the time of break-away, s, from a fit of a release's closed form to the first readings of the motion.

    Args:
        record: the ramp.
        asymptote: a, rad/s², and b, rad/s, of its velocity a t - b.
        T: time constant, s; the friction is assumed to fall to f_c = m (b / a - T) at once. None where it is not known:
            the friction is assumed not to fall.
    """
    # here, because --help of the command must not wait for it
    from scipy.optimize import minimize_scalar

    time, angle, first = first_motion(record)
    a, b = asymptote
    latest = float(time[first])
    if T is None:
        latest = min(latest, b / a - 1e-3 * record.tick)
    bounds = (latest - EARLIER_TICKS * record.tick, latest)
    onset = slice(max(first - 2, 0), first + ONSET_TICKS)

    def misfit(moment: float) -> float:
        constant = b / a - moment if T is None else T
        released = RampModel(b - a * constant, 1.0, constant, a, (moment + constant) * a - b)
        return float(np.sum((released.angle(time[onset]) - angle[onset]) ** 2))

    return float(minimize_scalar(misfit, bounds=bounds, method="bounded").x)


def _stays_beyond(angle: Array, threshold: float) -> int:
    """Return the index of the first reading after which the angle never is below a threshold."""
    return int(np.argmax(np.logical_and.accumulate((angle >= threshold)[::-1])[::-1]))


def first_motion(record: RampRecord) -> tuple[Array, Array, int]:
    """Return time since the torque's zero, s, angle since the start, rad, and the reading from which the shaft moves.

    After that reading the shaft never is back at its start.
    """
    time = record.time - record.origin
    angle = record.angle - record.angle[0]
    torque = record.torque

    def refuse(reason: str) -> NoReturn:
        raise IdentificationError(f"{record.label}: {reason}")

    if torque is not None:
        late = np.abs(torque - record.slope * (time + record.tick / 2))
        allowed = max(
            1.5 * float(np.abs(np.diff(torque)).max(initial=0.0)), 2 * record.slope * record.tick
        )
        if late.max() > allowed:
            where = f"by {late.max():.3g} Nm at {time[np.argmax(late)]:.2f} s"
            refuse(
                f"the commanded torque leaves the ramp of {record.slope:.4g} Nm/s {where}; "
                "the command saturates or the slope is wrong"
            )
    moved = (MOVED_COUNTS - 0.5) * record.angle_step
    if angle[-1] < moved:
        refuse(f"no break-away up to {record.slope * time[-1]:.3g} Nm; raise the end torque")
    first = _stays_beyond(angle, max(moved, MOVED_SHARE * angle[-1]))
    if first == 0:
        refuse("the shaft moves at the first reading; a ramp starts from rest")
    return time, angle, first
