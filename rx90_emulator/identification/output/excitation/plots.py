"""The plots of the report on excitation runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from rx90_common.base.arrays import Array
from rx90_common.report.plot import COLOURS, Band, Curve, Dots, Heat, Level, Panel, Plot
from rx90_emulator.identification.excitation.friction.estimates import FrictionCurve
from rx90_emulator.identification.excitation.torques import JointTorque, RunTorques, SpeedResiduals

_WINDOW = 60.0  # s of a run that are drawn: more would blur
_BINS = 20
_FEWEST = 8  # samples in a bin that is drawn
_RECORDED, _PREDICTED, _RESIDUAL = COLOURS[5], COLOURS[1], COLOURS[6]
_TIME, _SPEED = "time since the first motion, s", "velocity of the element, rad/s"


def torque_plot(run: RunTorques) -> Plot:
    """Show recorded and predicted torque and their difference, a panel for each joint."""
    moving = [joint.time for joint in run.joints if len(joint.time)]
    start = min(float(time[0]) for time in moving)
    panels = []
    for number, (name, joint) in enumerate(zip(run.names, run.joints, strict=True)):
        shown = _window(joint, start)
        time = shown.time - start
        curves = [
            Curve(time, shown.recorded, "measured", _RECORDED, 1.8),
            Curve(time, shown.predicted, "predicted", _PREDICTED, 0.8),
            Curve(time, shown.residual, "difference", _RESIDUAL, 0.6),
        ]
        panels.append(Panel(curves, name, _TIME if number == len(run.names) - 1 else "", "Nm"))
    return Plot(panels, height=1.7, share_x=True)


def _window(joint: JointTorque, start: float) -> JointTorque:
    """Return the first part of a series, with NaN where the joint stands still."""
    count = int(np.searchsorted(joint.time, start + _WINDOW))
    part = JointTorque(*(values[: max(1, count)] for values in joint))
    steps = np.diff(part.time)
    gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)
    return JointTorque(*(np.insert(values, gaps, np.nan) for values in part))


def spectra_plot(runs: Sequence[RunTorques]) -> Plot:
    """Show the amplitude spectra of measured torque and residual, a panel for each joint."""
    names, panels = runs[0].names, []
    for number, name in enumerate(names):
        joints = [run.joints[number] for run in runs]
        recorded, residual = _spectrum(joints, 2), _spectrum(joints, None)
        if recorded is None or residual is None:
            panels.append(Panel([], f"{name}: stands still"))
            continue
        curves = [
            Curve(*recorded, "measured", _RECORDED, 1.3),
            Curve(*residual, "difference", _PREDICTED, 0.9),
        ]
        below = "frequency, Hz" if number >= len(names) - 2 else ""
        panels.append(Panel(curves, name, below, "Nm/√Hz", "log", "log"))
    return Plot(panels, columns=2, height=1.9)


def _spectrum(joints: Sequence[JointTorque], column: int | None) -> tuple[Array, Array] | None:
    """Return frequencies, Hz, and the root of the mean spectral density of all runs; 0 where a joint stands still."""
    series = []
    step = min((float(np.median(np.diff(joint.time))) for joint in joints if len(joint.time) > 1), default=0.0)
    for joint in joints:
        if len(joint.time) > 1:
            place = np.rint((joint.time - joint.time[0]) / step).astype(np.intp)
            even = np.zeros(place[-1] + 1)
            even[place] = joint.residual if column is None else joint[column]
            series.append(even)
    if not series:
        return None
    length = min(max(map(len, series)), max(64, round(20.0 / step)))
    weights = [len(even) for even in series]
    found = [
        welch(even, 1.0 / step, nperseg=min(length, len(even)), nfft=length, detrend="constant") for even in series
    ]
    density = np.average([power for _, power in found], axis=0, weights=weights)
    return found[0][0][1:-1], np.sqrt(density[1:-1])


def speed_plot(speeds: Sequence[SpeedResiduals]) -> Plot:
    """Show the mean residual against the velocity of each element, with 95 % intervals."""
    panels = []
    for number, one in enumerate(speeds):
        marks: list[Level | Curve | Dots] = [Level(0.0, colour=_RESIDUAL)]
        if len(one.velocity):
            bars = 1.96 * np.nan_to_num(one.deviation)
            marks.append(Curve(one.velocity, one.residual, "", COLOURS[0], 0.9))
            marks.append(Dots(one.velocity, one.residual, "mean of a bin, 95 %", COLOURS[0], bars))
        panels.append(Panel(marks, one.element, _SPEED if number >= len(speeds) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=1.9)


def binned(velocity: Array, values: Array) -> Array:
    """Return for each bin of velocity its centre, the mean of the values, and their 10th and 90th percentile.

    Bins hold about the same number of samples, those of either sign apart.

    Args:
        velocity: rad/s, shape (k,).
        values: shape (k,).

    Returns:
        Shape (b, 4), sorted by velocity.
    """
    found = []
    for sign in (-1.0, 1.0):
        mine = np.flatnonzero(sign * velocity > 0.0)
        parts = np.array_split(mine[np.argsort(velocity[mine])], _BINS // 2)
        for part in parts:
            if len(part) >= _FEWEST:
                low, high = np.percentile(values[part], (10.0, 90.0))
                found.append((velocity[part].mean(), values[part].mean(), low, high))
    return np.array(found).reshape(-1, 4)


def time_plot(runs: Sequence[RunTorques], block: float) -> Plot:
    """Show the mean of the residual against the motion over blocks of time, each run with its colour."""
    names, panels = runs[0].names, []
    starts = [min((float(joint.time[0]) for joint in run.joints if len(joint.time)), default=0.0) for run in runs]
    for number, name in enumerate(names):
        marks: list[Level | Curve] = [Level(0.0, colour=_RESIDUAL)]
        for which, run in enumerate(runs):
            joint = run.joints[number]
            if not len(joint.time):
                continue
            place = ((joint.time - starts[which]) / block).astype(np.intp)
            count = np.bincount(place)
            used = np.flatnonzero(count)
            means = np.bincount(place, joint.residual * np.sign(joint.velocity))[used] / count[used]
            label = run.source.path.name if 1 < len(runs) <= len(COLOURS) else ""
            colour = COLOURS[which % len(COLOURS)]
            marks.append(
                Curve(np.asarray((used + 0.5) * block, dtype=np.float64), means, label, colour, 0.8, dots=True)
            )
        panels.append(Panel(marks, name, _TIME if number >= len(names) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=1.9)


def curve_plots(curves: Sequence[FrictionCurve], points: Sequence[Array]) -> Plot:
    """Show the friction torque of each element against its velocity with its band.

    Args:
        curves: of the elements.
        points: means of the measured torque for each element: velocity and torque, shape (b, 2); may be empty.
    """
    panels = []
    for number, (curve, measured) in enumerate(zip(curves, points, strict=True)):
        marks: list[Level | Band | Curve | Dots] = [
            Level(0.0, colour=_RESIDUAL),
            Level(0.0, colour=_RESIDUAL, upright=True),
        ]
        for sign in (-1.0, 1.0):
            side = sign * curve.velocity > 0.0
            low, high = (bound[side] for bound in curve.band)
            velocity = curve.velocity[side]
            marks.append(Band(velocity, low, high, "95 %", COLOURS[5]))
            marks.append(Curve(velocity, curve.torque[side], "identified", COLOURS[0], 1.2))
        if len(measured):
            marks.append(Dots(measured[:, 0], measured[:, 1], "measured", COLOURS[1]))
        panels.append(Panel(marks, curve.element, _SPEED if number >= len(curves) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=2.3)


def correlation_plot(names: Sequence[str], covariance: Array) -> Plot:
    """Show the correlation of all parameters as a heat map."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.isfinite(deviation) & (deviation > 0.0)
    labels = [name for name, one in zip(names, known.tolist(), strict=True) if one]
    matrix = covariance[np.ix_(known, known)] / np.outer(deviation[known], deviation[known])
    return Plot([Heat(labels, matrix)], height=7.0)
