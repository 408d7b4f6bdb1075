"""The measured quantities of a run, and their limits: absolute, or relative to the CS7B."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import detrend, find_peaks
from scipy.signal.windows import hann

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.declared import Declared
from rx90_common.base.entries import Number
from rx90_common.exchange.topics import motor_names
from rx90_emulator.conformance.battery import START, Case, Record
from rx90_emulator.loop.line import path_accuracy

_SETTLED_SHARE = 0.02  # of the way of a step
_RIPPLE_WINDOW = 0.02  # s
_HUNTED = 5.0  # s at the end of a run
_COUNTS = 3  # of the encoder, up to which there is no motion
_AT_REST = 0.1  # s at the end of a run
_NYQUIST_SHARE = 0.96


def _factor(what: str) -> Number:
    return Number(f"Most of the {what}, times what the CS7B has.", "1", low=1.0)


@dataclass(frozen=True)
class CheckLimits(Declared):
    """Limits of the quantities; those with a factor are relative to the CS7B's value in the same case."""

    name = "limits"
    about = "Limits of the controller check: of a quantity by itself, or a factor over the CS7B and an allowance."

    error_factor: Annotated[float, _factor("RMS and peak of the joints' errors")] = 3.0
    error_allowance: Annotated[float, Number("Added to that.", "rad", low=0.0, high=1.0)] = 1e-4
    path_factor: Annotated[float, _factor("distance of the tool from its line")] = 3.0
    path_allowance: Annotated[float, Number("Added to that.", "m", low=0.0, high=1.0)] = 5e-5
    ripple_factor: Annotated[float, _factor("commanded torque less its mean over 20 ms, RMS")] = 3.0
    ripple_allowance: Annotated[float, Number("Added to that.", "Nm", low=0.0, high=1e4)] = 0.2
    overshoot: Annotated[float, Number("Most beyond the end of a step, over its way.", "1", low=0.0, high=10.0)] = 0.1
    settling_time: Annotated[float, Number("Longest until a step stays within 2 % of its way.", "s", low=0.0)] = 0.3
    recovery_time: Annotated[float, Number("The same where drives were saturated.", "s", low=0.0)] = 0.8
    rest_error: Annotated[float, Number("Most of an error that is left at rest.", "rad", low=0.0, high=1.0)] = 3e-4
    hunting: Annotated[float, Number("Most of a motion at rest, peak to peak.", "rad", low=0.0, high=1.0)] = 1e-4
    gain_margin: Annotated[float, Number("Least of the loops.", "dB", low=0.0)] = 6.0
    phase_margin: Annotated[float, Number("Least of the loops.", "deg", low=0.0, high=180.0)] = 30.0
    modulus_margin: Annotated[float, Number("Least distance of the loops from -1.", "1", low=0.0, high=1.0)] = 0.45

    @classmethod
    def load(cls, path: Path | None) -> CheckLimits:
        """Read a file of limits; missing values, and None for no file, are the defaults.

        Raises:
            ConfigError: naming file, key, value and accepted range.
        """
        return cls() if path is None else cls.of_file(CHECK_LIMITS.read(load_yaml(path)))


CHECK_LIMITS = CheckLimits.group()
"""The contents of a file of limits."""


class Quantity(NamedTuple):
    """A quantity: its unit, its meaning in words, and its limit.

    Attributes:
        unit: of its values.
        about: in words.
        limit: name of the field of CheckLimits with the limit; "" for none. With `factor` its name without `_factor`.
        least: whether the limit is a minimum.
        factor: whether it is a factor on the CS7B's value, with an allowance.
    """

    unit: str
    about: str
    limit: str = ""
    least: bool = False
    factor: bool = False


QUANTITIES: Final[Mapping[str, Quantity]] = {
    "time_run": Quantity("s", "how far the run came", "duration", least=True),
    "torque_off": Quantity("s", "time without torque", "none"),
    "tracking_error_peak": Quantity("rad", "largest error of the joint's position", "error", factor=True),
    "tracking_error_rms": Quantity("rad", "its root mean square", "error", factor=True),
    "path_error": Quantity("m", "largest distance of the tool from its line", "path", factor=True),
    "torque_ripple": Quantity("Nm", "commanded torque less its mean over 20 ms, RMS", "ripple", factor=True),
    "overshoot": Quantity("1", "beyond the end of the step, over its way", "overshoot"),
    "settling_time": Quantity("s", "from the end of the step until it stays within 2 %", "settling_time"),
    "recovery_time": Quantity("s", "the same, with drives that were saturated", "recovery_time"),
    "rest_error": Quantity("rad", "what is left of the error in the last 0.1 s", "rest_error"),
    "hunting": Quantity("rad", "motion at rest in the last 5 s, peak to peak", "hunting"),
    "hunting_period": Quantity("s", "its period, where it turns back at least twice"),
    "gain_margin": Quantity("dB", "gain at the phase crossover", "gain_margin", least=True),
    "phase_margin": Quantity("deg", "phase at the gain crossover", "phase_margin", least=True),
    "modulus_margin": Quantity("1", "least distance of the loop from -1", "modulus_margin", least=True),
    "crossover": Quantity("Hz", "frequency at which the loop's gain is 1"),
}
"""All quantities, in the order of the report."""

Values = dict[tuple[str, str], float]
"""Measured values of a run, by quantity and joint."""


class Finding(NamedTuple):
    """One value, with the CS7B's.

    Attributes:
        case: its name.
        quantity: of QUANTITIES.
        joint: its name, of a motor for margins at motors, or "tool", or "all".
        value: NaN if there is none, such as a margin beyond the frequencies of the sweep.
        of_cs7b: the CS7B's value.
        limit: NaN for none.
        passed: whether the limit is kept.
    """

    case: str
    quantity: str
    joint: str
    value: float
    of_cs7b: float
    limit: float
    passed: bool

    @property
    def text(self) -> str:
        """Return value and limit in one line."""
        one = QUANTITIES[self.quantity]
        return (
            f"{self.case}: {self.quantity} of {self.joint} is {self.value:.4g} {one.unit}; accepted: "
            f"{'at least' if one.least else 'up to'} {self.limit:.4g} {one.unit} (CS7B {self.of_cs7b:.4g})"
        )


def judge(case: Case, values: Values, of_cs7b: Values, limits: CheckLimits) -> list[Finding]:
    """Return the findings of a case, each with its limit.

    Args:
        case: the case.
        values: of the controller.
        of_cs7b: of the CS7B.
        limits: of the quantities.
    """
    findings = []
    for (name, joint), value in values.items():
        one, other = QUANTITIES[name], of_cs7b.get((name, joint), math.nan)
        if one.factor:
            limit = getattr(limits, f"{one.limit}_factor") * other + getattr(limits, f"{one.limit}_allowance")
        elif one.limit in ("duration", "none"):
            limit = case.ticks * case.setup.rates.period if one.least else 0.0
        else:
            limit = getattr(limits, one.limit) if one.limit else math.nan
        passed = not (value < limit if one.least else value > limit)
        findings.append(Finding(case.name, name, joint, value, other, limit, passed))
    return findings


def measure(record: Record, set_points: Array, at_joints: bool | None = None) -> Values:
    """Return the measured values of a run.

    Args:
        record: of the run.
        set_points: one for each tick of the position loop, shape (m, 3, n).
        at_joints: whether loops are named after joints, not motors; None for the kind of the commands.
    """
    case, joints = record.case, record.case.setup.robot.joint_names
    at_joints = record.at_joints if at_joints is None else at_joints
    commanded = joints if at_joints else motor_names(len(joints))
    position, torque, times = record.position, record.torque, record.times
    done = len(position) * record.ticks
    off = np.isnan(torque).any(axis=1)
    values: Values = {("time_run", "all"): min(done, case.ticks) * case.setup.rates.period,
                      ("torque_off", "all"): float(off.sum()) * record.period}  # fmt: skip
    if done < case.ticks:
        return values
    error = tracking_error(record, set_points)
    moving = times >= START
    if case.sines is not None:
        for name, loop in zip(commanded, loops(record), strict=True):
            values |= {(quantity, name): value for quantity, value in loop.margins().items()}
        return values
    for j, name in enumerate(joints):
        own, requested = error[moving, j], np.nan_to_num(torque[moving, j])
        ripple = requested - uniform_filter1d(requested, max(1, round(_RIPPLE_WINDOW / record.period)))
        values |= {
            ("tracking_error_peak", name): float(np.abs(own).max()),
            ("tracking_error_rms", name): _rms(own),
            ("torque_ripple", name): _rms(ripple),
        }
        rest = round(_AT_REST / record.period)
        if case.name in ("step", "saturation"):
            way = float(case.points.position[-1, j] - case.points.position[0, j])
            beyond = (position[:, j] - case.points.position[-1, j]) / way
            late = np.flatnonzero(np.abs(error[:, j]) > _SETTLED_SHARE * abs(way))
            settled = max(0.0, times[late[-1]] + record.period - case.end) if len(late) else 0.0
            values["overshoot", name] = max(0.0, float(beyond.max()))
            values["settling_time" if case.name == "step" else "recovery_time", name] = settled
        if case.name in ("step", "saturation", "rest"):
            values["rest_error", name] = abs(float(error[-rest:, j].mean()))
        if case.name == "rest":
            counts = case.setup.drives.encoder_counts * np.abs(case.setup.drives.gear) / (2.0 * math.pi)  # in a rad
            tail = position[times >= case.duration - _HUNTED, j]
            amplitude, period = oscillation(tail, record.period, _COUNTS / float(counts[j]))
            values |= {("hunting", name): amplitude, ("hunting_period", name): period}
    if case.task is not None:
        accuracy = path_accuracy(case.setup.robot, case.task, times, position, START)
        values["path_error", "tool"] = accuracy.worst
    return values


def tracking_error(record: Record, set_points: Array) -> Array:
    """Return set-points less positions, rad, shape (t, n); a set-point holds until the next one."""
    ratio, position = record.case.setup.rates.ratio, record.position
    ticks = np.arange(len(position)) * record.ticks
    rows = ticks // ratio
    held: Array = set_points[rows, 0]
    if record.ticks < ratio:  # between two of them the set-point moves on
        after = set_points[np.minimum(rows + 1, len(set_points) - 1), 0]
        held = held + (ticks % ratio / ratio)[:, None] * (after - held)
    return held - position


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def oscillation(position: Array, period: float, still: float) -> tuple[float, float]:
    """Return the peak-to-peak size of a motion, and its period, s; NaN if it does not turn twice.

    A turn is a peak with a prominence of half of the whole size: single slips, and decaying motions, have no period.

    Args:
        position: rad, shape (n,).
        period: of the samples, s.
        still: size up to which it is at rest, rad.
    """
    size = float(np.ptp(position))
    turns = np.sort(np.concatenate([find_peaks(sign * position, prominence=0.5 * size)[0] for sign in (1.0, -1.0)]))
    if size <= still or len(turns) < 2:
        return size, math.nan
    return size, 2.0 * float(np.diff(turns).mean()) * period


class Loop(NamedTuple):
    """A loop opened at its command: response of the controller's commands to the drives' torques, with reversed sign.

    Attributes:
        frequency: Hz, shape (k,), increasing.
        gain: complex, shape (k,).
    """

    frequency: Array
    gain: NDArray[np.complex128]

    @property
    def bode(self) -> dict[str, Array]:
        """Return gain and phase for a plot, by the labels of their axes."""
        phase = np.degrees(np.unwrap(np.angle(self.gain)))
        return {"gain, dB": 20.0 * np.log10(np.abs(self.gain)), "phase, deg": phase}

    def margins(self) -> dict[str, float]:
        """Return gain margin, dB, phase margin, deg, modulus margin, and crossover, Hz; NaN if it is not crossed.

        Between two frequencies magnitude, dB, and phase are interpolated linearly in the frequency's logarithm. With
        several crossings the smallest margin counts; a loop that must not lose gain has a gain margin, too.
        """
        octave, (level, phase) = np.log(self.frequency), self.bode.values()
        crossed = _crossings(octave, level, 0.0)
        phases = [(np.interp(at, octave, phase) + 180.0) % 360.0 for at in crossed]
        levels = [abs(float(np.interp(at, octave, level)))
                  for turn in range(-3, 3) for at in _crossings(octave, phase, 180.0 + 360.0 * turn)]  # fmt: skip
        return {
            "gain_margin": min(levels, default=math.nan),
            "phase_margin": min((min(one, 360.0 - one) for one in phases), default=math.nan),
            "modulus_margin": float(np.abs(1.0 + self.gain).min()),
            "crossover": math.exp(max(crossed)) if len(crossed) else math.nan,
        }


def _crossings(x: Array, y: Array, level: float) -> list[float]:
    above = y > level
    at = np.flatnonzero(above[1:] != above[:-1])
    return [float(x[k] + (level - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k])) for k in at]


def loops(record: Record) -> list[Loop]:
    """Return the loop of each command, from the run in which sines are added to the torques, with the others closed.

    Over whole periods of the sines, with a Hann window: L = -U / (U + D), with the spectra of the controller's commands
    U and of the sines D. Set-points and feed-forward do not affect it, because they are no sines.
    """
    sines = record.case.sines
    assert sines is not None
    begin, end = (round(time / record.period) for time in sines.measured)
    count, window = end - begin, hann(end - begin, sym=False)[:, None]
    answered, added = (
        np.fft.rfft(detrend(np.nan_to_num(values[begin:end]), axis=0) * window, axis=0)
        for values in (record.sent, record.added)
    )
    found = []
    for j, frequency in enumerate(sines.frequency):
        known = frequency[frequency < _NYQUIST_SHARE * 0.5 / record.period]
        rows = np.round(known * count * record.period).astype(np.intp)
        u, d = answered[rows, j], added[rows, j]
        found.append(Loop(known, -u / (u + d)))
    return found
