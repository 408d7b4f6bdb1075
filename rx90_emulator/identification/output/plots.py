"""The report's plots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from rx90_common.base.arrays import Array
from rx90_common.report.drawing import COLOURS, as_svg, make_figure
from rx90_emulator.identification.presliding.fit import HysteresisLoop
from rx90_emulator.identification.result.identification import FrictionIdentification
from rx90_emulator.identification.result.validation import Validation
from rx90_emulator.identification.sliding.fit import CurvePoints

_MOST_POINTS = 3000
_INTERVAL = 1.96  # standard deviations, 95 %
_LOOPS = 20  # one part in so many of a micro-oscillation is drawn: more loops would cover each other
_INK, _BAND = "#222222", "#888888"


def curve_plots(result: FrictionIdentification) -> list[str]:
    """Return torque against velocity of each element, with the residuals below."""
    named = zip(result.arm.element_names, result.sliding.curves, strict=True)
    return [_curve(name, curve, COLOURS[0]) for name, curve in named if len(curve.velocity)]


def drift_plots(result: FrictionIdentification) -> list[str]:
    """Return residual torque along the motion against time of each element."""
    plots = []
    for name, curve in zip(result.arm.element_names, result.sliding.curves, strict=True):
        if len(curve.velocity):
            figure, (axes,) = make_figure(1, 1.8)
            axes.set_title(name, loc="left")
            axes.plot(
                curve.time,
                np.sign(curve.velocity) * (curve.torque - curve.fitted),
                ".",
                color=COLOURS[0],
                markersize=4,
            )
            axes.axhline(0.0, color=_INK, linewidth=0.6)
            axes.set_xlabel("time in the series, s")
            axes.set_ylabel("residual, Nm")
            _margins(figure, left=0.1, right=0.99, bottom=0.25, top=0.88)
            plots.append(as_svg(figure))
    return plots


def _curve(name: str, curve: CurvePoints, colour: str) -> str:
    figure, (above, below) = make_figure(2, 4.2)
    above.set_title(name, loc="left")
    above.plot(curve.velocity, curve.torque, ".", color=colour, markersize=5, label="measured, one stretch each")
    for label, line in (("identified", curve.line[:, curve.line[0] < 0.0]), ("_", curve.line[:, curve.line[0] > 0.0])):
        velocity, torque, deviation = line
        above.plot(velocity, torque, color=_INK, linewidth=0.9, label=label)
        below.fill_between(
            velocity,
            -_INTERVAL * deviation,
            _INTERVAL * deviation,
            color=_BAND,
            alpha=0.35,
            linewidth=0.0,
            label="95 % of the identified curve" if label != "_" else label,
        )
    below.errorbar(
        curve.velocity,
        curve.torque - curve.fitted,
        _INTERVAL * curve.deviation,
        fmt=".",
        color=colour,
        markersize=4,
        linewidth=0.6,
        label="measured - identified, 95 % of the noise",
    )
    below.axhline(0.0, color=_INK, linewidth=0.6)
    speed = np.abs(curve.velocity)
    decades = 10.0 ** np.arange(np.ceil(np.log10(speed.min())), np.floor(np.log10(speed.max())) + 1.0)
    ticks = np.concatenate([-decades[::-1], [0.0], decades])
    for axes in (above, below):
        axes.set_xscale("symlog", linthresh=float(speed.min()), linscale=0.3)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.axvline(0.0, color=_INK, linewidth=0.4)
    above.set_ylabel("friction torque, Nm")
    below.set_ylabel("residual, Nm")
    below.set_xlabel("velocity of the element, rad/s (logarithmic on either side)")
    above.legend(loc="upper left", frameon=False, fontsize=8)
    below.margins(y=0.3)
    below.legend(loc="upper left", frameon=False, ncols=2, fontsize=8)
    _margins(figure, left=0.1, right=0.99, bottom=0.11, top=0.94, hspace=0.08)
    return as_svg(figure)


def _margins(figure: Figure, **shares: float) -> None:
    """Set the margins: a layout engine takes as long as the drawing."""
    figure.set_layout_engine(None)
    figure.subplots_adjust(**shares)


def hysteresis_plot(loop: HysteresisLoop) -> str:
    """Return friction torque against position in the middle of one micro-motion, measured and simulated, as SVG."""
    figure, (axes,) = make_figure(1, 3.2)
    count = len(loop.position)
    part = slice((_LOOPS - 1) * count // (2 * _LOOPS), (_LOOPS + 1) * count // (2 * _LOOPS))
    axes.set_title(loop.joint, loc="left")
    axes.plot(loop.position[part] * 1e6, loop.torque[part], color=COLOURS[5], linewidth=1.8, label="measured")
    axes.plot(
        loop.position[part] * 1e6,
        loop.simulated_torque[part],
        color=COLOURS[1],
        linewidth=0.8,
        label="simulated",
    )
    axes.set_xlabel("position, µrad")
    axes.set_ylabel("friction torque, Nm")
    axes.legend(loc="upper left", frameon=False)
    _margins(figure, left=0.1, right=0.99, bottom=0.15, top=0.92)
    return as_svg(figure)


def correlation_plots(result: FrictionIdentification) -> list[str]:
    """Return the correlation of each element's parameters."""
    pages = []
    pairs = zip(result.arm.element_names, result.sliding.estimates, result.presliding.estimates, strict=True)
    for name, sliding, presliding in pairs:
        names = (*sliding.parameters, *presliding.parameters)
        size, first = len(names), len(sliding.parameters)
        matrix = np.full((size, size), np.nan)
        matrix[:first, :first] = sliding.correlation
        matrix[first:, first:] = presliding.correlation
        if np.isfinite(matrix).any():
            pages.append(_matrix(name, names, matrix))
    return pages


def _matrix(name: str, parameters: Sequence[str], matrix: Array) -> str:
    figure, (axes,) = make_figure(1, 3.6)
    figure.set_size_inches(4.4, 3.8)
    axes.grid(visible=False)
    axes.imshow(matrix, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    ticks = range(len(parameters))
    axes.set_xticks(ticks, parameters, rotation=45, ha="right")
    axes.set_yticks(ticks, parameters)
    axes.set_title(name, loc="left")
    for (i, j), value in np.ndenumerate(matrix):
        if np.isfinite(value):
            shade = "white" if abs(value) > 0.6 else "black"
            axes.text(j, i, f"{value:.2f}".replace("-0.00", "0.00"), ha="center", va="center", fontsize=6, color=shade)
    _margins(figure, left=0.25, right=0.98, bottom=0.25, top=0.93)
    return as_svg(figure)


def validation_plot(check: Validation) -> str:
    """Return recorded and predicted torque of each joint, their difference, and the distance of the tips."""
    tips = len(check.tip_distance) > 0
    count = len(check.names)
    figure, axes = make_figure(count + 1 + tips, 1.5 * (count + tips) + 2.0, share_x=True)
    stride = max(1, len(check.torque.time) // _MOST_POINTS)
    time, recorded, predicted, moves = (values[::stride] for values in check.torque)
    compared = moves > 0.0
    largest = np.abs(check.torque.recorded).max(axis=0)
    for joint, panel in enumerate(axes[:count]):
        panel.plot(time, recorded[:, joint], color=COLOURS[5], linewidth=1.8, label="recorded")
        panel.plot(time, predicted[:, joint], color=COLOURS[1], linewidth=0.7, label="predicted")
        panel.set_ylabel(f"{check.names[joint]}, Nm")
        share = 100.0 * (predicted - recorded)[:, joint] / largest[joint]
        axes[count].plot(
            time,
            np.where(compared[:, joint], share, np.nan),
            color=COLOURS[joint % len(COLOURS)],
            linewidth=0.7,
            label=check.names[joint],
        )
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, ncols=2)
    axes[count].set_ylabel("difference,\n% of largest")
    axes[count].legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), frameon=False, ncols=8, fontsize=7)
    if tips:
        _tips(axes[-1], check)
    axes[-1].set_xlabel("time, s")
    return as_svg(figure)


def _tips(axes: Axes, check: Validation) -> None:
    stride = max(1, len(check.tip_time) // _MOST_POINTS)
    axes.plot(check.tip_time[::stride], check.tip_distance[::stride] * 1e6, color=COLOURS[0], linewidth=0.8)
    axes.set_ylabel("tip distance, µm")
