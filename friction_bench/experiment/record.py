"""One ramp test as data: from a rig, a CSV file, or the plain text that the source's program saved; its sliding part.

Useless ramps are refused here, by `first_motion` and `sliding_window`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, IdentificationError, Rx90Error
from rx90_common.base.quoting import counted, quoted
from rx90_common.base.text_lines import read_lines
from rx90_common.process.files import atomic_files

CSV_COLUMNS = ("time", "counts", "torque", "measured_torque")
INSTANTANEOUS = "instantaneous-velocity"
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
SATURATION_LIMIT = 0.06
"""Relative shortfall of the measured torque that counts as saturation."""


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
        return a * s - (self.release / self.viscous - a * T) * np.expm1(-s / T)

    def angle(self, time: ArrayLike) -> Array:
        """Return the angle since rest, rad."""
        s, T, a = self._since_release(time)
        return a * s * s / 2 + (self.release / self.viscous - a * T) * (s + T * np.expm1(-s / T))

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
        if not (math.isfinite(self.slope) and self.slope > 0.0):
            raise RecordError(
                f"{self.label}: slope m is {self.slope:g} Nm/s; accepted: a number > 0"
            )

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


def _rows(path: Path, split: Callable[[str], list[str]]) -> list[tuple[int, list[str]]]:
    """Return number and fields of each line that holds some; lines that start with # or % are comments."""
    try:
        rows = [(number, split(line)) for number, line in enumerate(read_lines(path), 1)]
    except csv.Error as error:
        raise RecordError(f"{path}: cannot be read ({error})") from error
    except ConfigError as error:
        raise RecordError(str(error)) from error
    return [(number, row) for number, row in rows if any(row) and not row[0].startswith(("#", "%"))]


def read_csv(path: Path, slope: float, angle_step: float, loaded: bool = False) -> RampRecord:
    """Read a CSV file with a header of `time` (s) and `counts`, and perhaps `torque`, `measured_torque` (Nm).

    Lines that start with # are comments.

    Raises:
        RecordError: naming line and column of what cannot be used.
    """
    rows = _rows(path, lambda line: next(csv.reader([line]), []))
    if not rows:
        raise RecordError(f"{path}: is empty; accepted: a header and at least 2 readings")
    header = [name.strip() for name in rows.pop(0)[1]]
    columns: dict[str, Array] = {}
    for name in CSV_COLUMNS:
        if name in header:
            at = header.index(name)
            columns[name] = np.array(
                [_number(path, line, name, row[at : at + 1]) for line, row in rows]
            )
        elif name in CSV_COLUMNS[:2]:
            lacking = f"column {quoted(name)} is missing, found {quoted(', '.join(header)[:80])}"
            raise RecordError(f"{path}: {lacking}; accepted: {', '.join(CSV_COLUMNS)}")
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


def _number(path: Path, line: int, name: str, field: list[str]) -> float:
    """Return the number that a field of a line, which may lack it, holds."""
    try:
        return float(field[0])
    except (IndexError, ValueError):
        found = quoted(field[0] if field else "nothing")
        raise RecordError(
            f"{path}: line {line}, column {name} holds {found}; accepted: a number"
        ) from None


def write_csv(record: RampRecord, path: Path) -> None:
    """Write a record so that `read_csv` gives it back."""
    counts = np.rint(record.angle / record.angle_step).astype(int)
    columns = record.time, counts, record.torque, record.measured_torque
    known = {
        name: column.tolist()
        for name, column in zip(CSV_COLUMNS, columns, strict=True)
        if column is not None
    }
    with (
        atomic_files(path) as (temporary,),
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        stream.write(f"# {record.label}, slope {record.slope!r} Nm/s\n")
        writer = csv.writer(stream)
        writer.writerow(known)
        writer.writerows(zip(*known.values(), strict=True))


def read_text(
    path: Path, kind: str, slope: float, angle_step: float, tick: float, loaded: bool = False
) -> RampRecord:
    """Read the plain text of the source's program: one reading per line, every 20 ms.

    A line holds one number, or time (s) and one number; tabs, blanks, commas and semicolons separate.
    The paper does not describe the numbers, so `kind` does: `increments` (pulses since the last
    reading), `counts` (pulses in all), `velocity` (rad/s, mean since the last reading), or `instantaneous velocity`
    (rad/s, at the reading).

    Raises:
        RecordError: naming file and line of what cannot be used.
    """
    rows = []
    for line, words in _rows(path, lambda line: line.replace(",", " ").replace(";", " ").split()):
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise RecordError(
                f"{path}: line {line} holds {quoted(' '.join(words))}; accepted: numbers"
            ) from None
        if len(words) not in {1, 2} or len(words) != len(rows[0]):
            holds = f"line {line} holds {counted(len(words), 'number')}"
            raise RecordError(f"{path}: {holds}; accepted: 1 or 2, the same on every line")
    if len(rows) < 2:
        raise RecordError(f"{path}: {counted(len(rows), 'reading')}; accepted: at least 2")
    table = np.array(rows)
    values: Array = table[:, -1]
    time: Array = (
        table[:, 0] if table.shape[1] == 2 else tick * np.arange(1, len(rows) + 1, dtype=np.float64)
    )
    step = float(np.median(np.diff(time)))
    if not tick / 2 <= step <= tick * 2:
        raise RecordError(
            f"{path}: its first column, read as time, advances by {step:.3g} a line; "
            f"accepted: s, about {tick:g} a line, and a point for decimals"
        )
    if kind == "counts":
        angle = values * angle_step
    elif kind == "increments":
        angle = np.cumsum(values) * angle_step
    else:
        # by the trapezoidal rule, from a reading at rest before the first one
        if kind == INSTANTANEOUS:
            values = (values + np.concatenate(([0.0], values[:-1]))) / 2
        angle = np.cumsum(values * np.diff(time, prepend=time[0] - tick))
    return RampRecord(time, np.asarray(angle), slope, angle_step, loaded=loaded, label=path.name)


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
    earliest = latest - EARLIER_TICKS * record.tick
    if T is None:
        latest = min(latest, b / a - 1e-3 * record.tick)
    else:
        earliest = min(max(b / a - T, earliest), latest - record.tick)
    onset = slice(max(first - 2, 0), first + ONSET_TICKS)

    def misfit(moment: float) -> float:
        released = RampModel(moment * a, 1.0, b / a - moment, a)
        if T is not None:
            released = RampModel(b - a * T, 1.0, T, a, (moment + T) * a - b)
        return float(np.sum((released.angle(time[onset]) - angle[onset]) ** 2))

    return float(
        minimize_scalar(misfit, bounds=(min(earliest, latest), latest), method="bounded").x
    )


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
    n = time.size // 5
    if torque is not None and record.measured_torque is not None and n > 0:
        # A reading is made just before the tick at which the command changes: it belongs to the previous one.
        command = torque[:-1]
        measured = record.measured_torque[1:]
        scale = float(np.sum(measured[n : 3 * n]) / np.sum(command[n : 3 * n]))
        shortfall = 1.0 - float(np.mean(measured[-n:]) / np.mean(command[-n:])) / scale
        if shortfall > SATURATION_LIMIT:
            refuse(
                f"the measured torque falls {100 * shortfall:.0f} % behind the command at the ramp's end; "
                "the amplifier saturates, end the ramp earlier"
            )
    return time, angle, first
