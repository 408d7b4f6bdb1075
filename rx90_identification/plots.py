"""The report's plots."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from rx90_identification.estimate import PARAMETERS
from rx90_identification.identify import Identification
from rx90_identification.presliding import HysteresisLoop
from rx90_identification.sliding import CurvePoints
from rx90_identification.validation import Validation
from rx90_report.drawing import COLOURS, as_svg, make_figure

_MOST_POINTS = 3000


def curves_plot(result: Identification) -> str:
    """Return torque against velocity of each element, with the residuals below."""
    parts = []
    for name, curve, colour in zip(result.arm.element_names, result.sliding.curves, _colours(result), strict=True):
        if len(curve.velocity):
            parts.append(_curve(name, curve, colour))
    return "\n".join(parts)


def _curve(name: str, curve: CurvePoints, colour: str) -> str:
    figure, (above, below) = make_figure(2, 3.6)
    order = np.argsort(curve.velocity)
    above.plot(curve.velocity, curve.torque, ".", color=colour, markersize=4, label=f"{name}, measured")
    above.plot(curve.velocity[order], curve.fitted[order], color="#222222", linewidth=0.9, label="identified")
    below.errorbar(
        curve.velocity,
        curve.torque - curve.fitted,
        1.96 * curve.deviation,
        fmt=".",
        color=colour,
        markersize=4,
        linewidth=0.6,
    )
    for axes in (above, below):
        axes.set_xscale("symlog", linthresh=1e-3)
    above.set_ylabel("friction torque, Nm")
    below.set_ylabel("residual, Nm")
    below.set_xlabel("velocity of the element, rad/s (logarithmic on either side)")
    above.legend(loc="upper left", frameon=False)
    return as_svg(figure)


def hysteresis_plot(loop: HysteresisLoop) -> str:
    """Return friction torque against position of one micro-motion, measured and simulated."""
    figure, (axes,) = make_figure(1, 3.0)
    stride = max(1, len(loop.position) // _MOST_POINTS)
    rows = slice(None, None, stride)
    axes.plot(
        loop.position[rows] * 1e6, loop.torque[rows], color=COLOURS[5], linewidth=0.6, label=f"{loop.joint}, measured"
    )
    axes.plot(
        loop.position[rows] * 1e6,
        loop.simulated_torque[rows],
        "--",
        color=COLOURS[1],
        linewidth=0.6,
        label="simulated",
    )
    axes.set_xlabel("position, µrad")
    axes.set_ylabel("friction torque, Nm")
    axes.legend(loc="upper left", frameon=False)
    return as_svg(figure)


def correlation_plot(result: Identification) -> str:
    """Return the correlation of each element's parameters."""
    pages = []
    pairs = zip(result.arm.element_names, result.sliding.estimates, result.presliding.estimates, strict=True)
    for name, sliding, presliding in pairs:
        size, first = len(PARAMETERS), len(sliding.parameters)
        matrix = np.full((size, size), np.nan)
        matrix[:first, :first] = sliding.correlation
        matrix[first:, first:] = presliding.correlation
        if np.isfinite(matrix).any():
            pages.append(_matrix(name, matrix))
    return "\n".join(pages)


def _matrix(name: str, matrix: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> str:
    figure, (axes,) = make_figure(1, 3.4)
    axes.grid(visible=False)
    image = axes.imshow(matrix, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    ticks = range(len(PARAMETERS))
    axes.set_xticks(ticks, PARAMETERS, rotation=45, ha="right")
    axes.set_yticks(ticks, PARAMETERS)
    axes.set_title(name)
    for (i, j), value in np.ndenumerate(matrix):
        if np.isfinite(value):
            shade = "white" if abs(value) > 0.6 else "black"
            axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=6, color=shade)
    figure.colorbar(image, ax=axes)
    return as_svg(figure)


def validation_plot(check: Validation) -> str:
    """Return recorded and predicted torque of each joint, and the distance of the tips."""
    tips = len(check.tip_distance) > 0
    count = len(check.names)
    figure, axes = make_figure(count + tips, 1.5 * (count + tips), share_x=True)
    stride = max(1, len(check.time) // _MOST_POINTS)
    for joint, panel in enumerate(axes[:count]):
        panel.plot(
            check.time[::stride], check.recorded[::stride, joint], color=COLOURS[5], linewidth=1.6, label="recorded"
        )
        panel.plot(
            check.time[::stride], check.predicted[::stride, joint], color=COLOURS[1], linewidth=0.7, label="predicted"
        )
        panel.set_ylabel(f"{check.names[joint]}, Nm")
    axes[0].legend(loc="upper right", frameon=False, ncols=2)
    if tips:
        _tips(axes[-1], check)
    axes[-1].set_xlabel("time, s")
    return as_svg(figure)


def _tips(axes: Axes, check: Validation) -> None:
    stride = max(1, len(check.tip_time) // _MOST_POINTS)
    axes.plot(check.tip_time[::stride], check.tip_distance[::stride] * 1e6, color=COLOURS[0], linewidth=0.8)
    axes.set_ylabel("tip distance, µm")


def _colours(result: Identification) -> list[str]:
    return [COLOURS[e % len(COLOURS)] for e in range(len(result.elements))]
