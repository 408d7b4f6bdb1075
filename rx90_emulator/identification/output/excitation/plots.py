"""The plots of the report on excitation runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullLocator
from scipy.signal import welch

from rx90_common.base.arrays import Array
from rx90_common.report.drawing import COLOURS, as_svg, make_figure, make_grid
from rx90_emulator.identification.excitation.fit_quality import SpeedResiduals
from rx90_emulator.identification.excitation.friction.models import FrictionCurve
from rx90_emulator.identification.excitation.torques import JointTorque, RunTorques

_WINDOW = 60.0  # s of a run that are drawn: more would blur
_MOST_POINTS = 1200
_BINS = 20
_FEWEST = 8  # samples in a bin that is drawn
_RECORDED, _PREDICTED, _RESIDUAL = COLOURS[5], COLOURS[1], COLOURS[6]
_BAND = "#888888"


def torque_plot(run: RunTorques) -> str:
    """Return recorded and predicted torque and their difference, a panel for each joint, as SVG."""
    figure, axes = make_grid(len(run.names), 1, 1.7)
    moving = [joint.time for joint in run.joints if len(joint.time)]
    start = min(float(time[0]) for time in moving)
    span = min(_WINDOW, max(float(time[-1]) for time in moving) - start)
    for panel, name, joint in zip(axes, run.names, run.joints, strict=True):
        shown = _window(joint, start)
        time = shown.time - start
        panel.plot(time, shown.recorded, color=_RECORDED, linewidth=1.8, label="measured")
        panel.plot(time, shown.predicted, color=_PREDICTED, linewidth=0.8, label="predicted")
        panel.plot(time, shown.residual, color=_RESIDUAL, linewidth=0.6, label="difference")
        _label(panel, name)
        panel.yaxis.set_major_locator(MaxNLocator(4))
        panel.set_xlim(-0.01 * span, 1.01 * span)
    _legend(axes)
    axes[-1].set_xlabel("time since the first motion, s")
    return as_svg(figure)


def _window(joint: JointTorque, start: float) -> JointTorque:
    """Return the first part of a series, thinned out, with NaN where the joint stands still."""
    count = int(np.searchsorted(joint.time, start + _WINDOW))
    part = JointTorque(*(values[: max(1, count) : 1 + count // _MOST_POINTS] for values in joint))
    steps = np.diff(part.time)
    gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)
    return JointTorque(*(np.insert(values, gaps, np.nan) for values in part))


def spectra_plot(runs: Sequence[RunTorques]) -> str:
    """Return the amplitude spectra of measured torque and residual, a panel for each joint, as SVG."""
    names = runs[0].names
    figure, axes = make_grid(len(names), 2, 1.9)
    for number, (panel, name) in enumerate(zip(axes, names, strict=True)):
        joints = [run.joints[number] for run in runs]
        recorded, residual = _spectrum(joints, 2), _spectrum(joints, None)
        if recorded is None or residual is None:
            _label(panel, f"{name}: stands still")
            continue
        panel.loglog(*recorded, color=_RECORDED, linewidth=1.3, label="measured")
        panel.loglog(*residual, color=_PREDICTED, linewidth=0.9, label="difference")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_minor_locator(NullLocator())
        _label(panel, name, "Nm/√Hz")
    _legend(axes)
    for panel in axes[-2:]:
        panel.set_xlabel("frequency, Hz")
    return as_svg(figure)


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


def speed_plot(speeds: Sequence[SpeedResiduals]) -> str:
    """Return the mean residual against the velocity of each element, with 95 % intervals, as SVG."""
    figure, axes = make_grid(len(speeds), 2, 1.9)
    for panel, one in zip(axes, speeds, strict=True):
        _label(panel, one.element)
        panel.xaxis.set_major_locator(MaxNLocator(6))
        panel.axhline(0.0, color=_RESIDUAL, linewidth=0.6)
        if len(one.velocity):
            bars = 1.96 * np.nan_to_num(one.deviation)
            panel.errorbar(one.velocity, one.residual, bars, fmt=".-", color=COLOURS[0], ecolor=_BAND, linewidth=0.9,
                           markersize=4, label="mean of a bin, 95 %")  # fmt: skip
    _legend(axes)
    for panel in axes[-2:]:
        panel.set_xlabel("velocity of the element, rad/s")
    return as_svg(figure)


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


def time_plot(runs: Sequence[RunTorques], block: float) -> str:
    """Return the mean of the residual against the motion over blocks of time, each run with its colour, as SVG."""
    names = runs[0].names
    figure, axes = make_grid(len(names), 2, 1.9)
    starts = [min((float(joint.time[0]) for joint in run.joints if len(joint.time)), default=0.0) for run in runs]
    for number, (panel, name) in enumerate(zip(axes, names, strict=True)):
        for which, run in enumerate(runs):
            joint = run.joints[number]
            if not len(joint.time):
                continue
            place = ((joint.time - starts[which]) / block).astype(np.intp)
            count = np.bincount(place)
            used = np.flatnonzero(count)
            means = np.bincount(place, joint.residual * np.sign(joint.velocity))[used] / count[used]
            colour = COLOURS[which % len(COLOURS)]
            panel.plot((used + 0.5) * block, means, ".-", color=colour, linewidth=0.8, markersize=4,
                       label=run.source.path.name)  # fmt: skip
        panel.axhline(0.0, color=_RESIDUAL, linewidth=0.6)
        _label(panel, name)
    if 1 < len(runs) <= len(COLOURS):
        _legend(axes, ncols=2 if len(runs) > 2 else 1, frameon=True, framealpha=0.8, edgecolor="none", loc="best")
    for panel in axes[-2:]:
        panel.set_xlabel("time since the first motion, s")
    return as_svg(figure)


def curve_plots(curves: Sequence[FrictionCurve], points: Sequence[Array]) -> str:
    """Return the friction torque of each element against its velocity with its band, as SVG.

    Args:
        curves: of the elements.
        points: means of the measured torque for each element: velocity and torque, shape (b, 2); may be empty.
    """
    figure, axes = make_grid(len(curves), 2, 2.3)
    for panel, curve, measured in zip(axes, curves, points, strict=True):
        for sign in (-1.0, 1.0):
            side = sign * curve.velocity > 0.0
            low, high = (bound[side] for bound in curve.band)
            velocity = curve.velocity[side]
            first = sign > 0.0
            panel.fill_between(velocity, low, high, color=COLOURS[5], alpha=0.5, linewidth=0.0,
                               label="95 %" if first else None)  # fmt: skip
            panel.plot(velocity, curve.torque[side], color=COLOURS[0], linewidth=1.2,
                       label="identified" if first else None)  # fmt: skip
        if len(measured):
            panel.plot(measured[:, 0], measured[:, 1], ".", color=COLOURS[1], markersize=5, label="measured")
        panel.axhline(0.0, color=_RESIDUAL, linewidth=0.5)
        panel.axvline(0.0, color=_RESIDUAL, linewidth=0.5)
        _label(panel, curve.element)
        panel.xaxis.set_major_locator(MaxNLocator(6))
    _legend(axes)
    for panel in axes[-2:]:
        panel.set_xlabel("velocity of the element, rad/s")
    return as_svg(figure)


def correlation_plot(names: Sequence[str], covariance: Array) -> str:
    """Return the correlation of all parameters as a heat map, as SVG."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.isfinite(deviation) & (deviation > 0.0)
    labels = [name for name, one in zip(names, known.tolist(), strict=True) if one]
    matrix = covariance[np.ix_(known, known)] / np.outer(deviation[known], deviation[known])
    figure, (axes,) = make_figure(1, 6.8)
    axes.grid(visible=False)
    image = axes.imshow(matrix, vmin=-1.0, vmax=1.0, cmap="RdBu_r", interpolation="nearest")
    size = max(3.5, min(8.0, 330.0 / max(1, len(labels))))
    axes.set_xticks(range(len(labels)), labels, rotation=90, fontsize=size)
    axes.set_yticks(range(len(labels)), labels, fontsize=size)
    axes.tick_params(length=0)
    figure.set_layout_engine(None)
    figure.subplots_adjust(left=0.16, right=0.99, bottom=0.19, top=0.99)
    figure.colorbar(image, ax=axes, shrink=0.5, label="correlation")
    return as_svg(figure)


def _label(panel: Axes, name: str, unit: str = "Nm") -> None:
    panel.set_title(name, loc="left", fontsize=9)
    panel.set_ylabel(unit)


def _legend(axes: Sequence[Axes], **options: Any) -> None:
    """Put a legend above the first panel in which something is drawn, beside its title, or elsewhere by the options."""
    beside: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97)}
    for panel in axes:
        if panel.get_legend_handles_labels()[0]:
            shape: dict[str, Any] = {
                "frameon": False,
                "fontsize": 7,
                "ncols": 3,
                "handlelength": 1.4,
                "columnspacing": 1.2,
            }
            panel.legend(**(shape | (options or beside)))
            return
