"""The report's plots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90_common.report.plot import COLOURS, GREY, INK, Band, Curve, Dots, Heat, Level, Panel, Plot
from rx90_emulator.identification.presliding.fit import HysteresisLoop
from rx90_emulator.identification.presliding.kinds import ElementKind
from rx90_emulator.identification.result.identification import FrictionIdentification
from rx90_emulator.identification.result.validation import Validation
from rx90_emulator.identification.sliding.fit import CurvePoints

_INTERVAL = 1.96  # standard deviations, 95 %
_LOOPS = 20  # one part in so many of a micro-oscillation is drawn: more loops would cover each other


def curve_plots(result: FrictionIdentification) -> list[Plot]:
    """Return torque against velocity of each element, with the residuals below."""
    named = zip(result.arm.element_names, result.sliding.curves, strict=True)
    return [_curve(name, curve) for name, curve in named if len(curve.velocity)]


def drift_plots(result: FrictionIdentification) -> list[Plot]:
    """Return residual torque along the motion against time of each element."""
    plots = []
    for name, curve in zip(result.arm.element_names, result.sliding.curves, strict=True):
        if len(curve.velocity):
            residual = np.sign(curve.velocity) * (curve.torque - curve.fitted)
            plots.append(
                Plot(
                    [Panel((Level(0.0), Dots(curve.time, residual)), name, "time in the series, s", "residual, Nm")],
                    height=1.8,
                )
            )
    return plots


def _curve(name: str, curve: CurvePoints) -> Plot:
    smallest = float(np.abs(curve.velocity).min())
    above: list[Curve | Dots | Level] = [
        Level(0.0, upright=True),
        Dots(curve.velocity, curve.torque, "measured, one stretch each"),
    ]
    below: list[Band | Dots | Level] = [Level(0.0, upright=True), Level(0.0)]
    for side in (curve.line[0] < 0.0, curve.line[0] > 0.0):
        velocity, torque, deviation = curve.line[:, side]
        above.append(Curve(velocity, torque, "identified", INK, 0.9))
        far = _INTERVAL * deviation
        below.append(Band(velocity, -far, far, "95 % of the identified curve", GREY))
    noise = _INTERVAL * curve.deviation
    label = "measured - identified, 95 % of the noise"
    below.append(Dots(curve.velocity, curve.torque - curve.fitted, label, COLOURS[0], noise))
    speeds = "velocity of the element, rad/s (logarithmic on either side)"
    panels = [
        Panel(above, name, "", "friction torque, Nm", "symlog", smallest=smallest),
        Panel(below, "", speeds, "residual, Nm", "symlog", smallest=smallest),
    ]
    return Plot(panels, height=2.3)


def hysteresis_plot(loop: HysteresisLoop) -> Plot:
    """Show friction torque against position in the middle of one micro-motion, measured and simulated."""
    part = _middle(len(loop.position))
    position = loop.position[part] * 1e6
    curves = [
        Curve(position, loop.torque[part], "measured", COLOURS[5], 1.8),
        Curve(position, loop.simulated_torque[part], "simulated", COLOURS[1], 0.8),
    ]
    return Plot([Panel(curves, loop.joint, "position, µrad", "friction torque, Nm")], height=3.2)


def kind_plot(kind: ElementKind) -> Plot:
    """Show torque against position along a stretch of the largest micro-motion: measured, and by each kind."""
    position, torques = kind.largest
    part = _middle(len(position))
    widths = {"measured": 1.8}
    colours = (COLOURS[5], COLOURS[1], COLOURS[2], COLOURS[3])
    curves = [
        Curve(position[part] * 1e6, torque[part], name, colour, widths.get(name, 0.8))
        for (name, torque), colour in zip(torques.items(), colours, strict=False)
    ]
    return Plot([Panel(curves, kind.element, "position, µrad", "torque of the bristles, Nm")], height=3.2)


def _middle(count: int) -> slice:
    return slice((_LOOPS - 1) * count // (2 * _LOOPS), (_LOOPS + 1) * count // (2 * _LOOPS))


def correlation_plots(result: FrictionIdentification) -> list[Plot]:
    """Return the correlation of each element's parameters."""
    plots = []
    others = [kind.element for kind in result.kinds if kind.trial is not None]  # their c0 and c1 are not this fit's
    pairs = zip(result.arm.element_names, result.sliding.estimates, result.presliding.estimates, strict=True)
    for name, sliding, presliding in pairs:
        names: Sequence[str] = (*sliding.parameters, *presliding.parameters)
        size, first = len(names), len(sliding.parameters)
        matrix = np.full((size, size), np.nan)
        matrix[:first, :first] = sliding.correlation
        if name not in others:
            matrix[first:, first:] = presliding.correlation
        if np.isfinite(matrix).any():
            plots.append(Plot([Heat(names, matrix, name)]))
    return plots


def validation_plot(check: Validation) -> Plot:
    """Show recorded and predicted torque of each joint, their difference, and the distance of the tips."""
    time, recorded, predicted, moves = check.torque
    share = 100.0 * (predicted - recorded) / np.abs(recorded).max(axis=0)
    share = np.where(moves > 0.0, share, np.nan)
    panels = [
        Panel(
            [
                Curve(time, recorded[:, joint], "recorded", COLOURS[5], 1.8),
                Curve(time, predicted[:, joint], "predicted", COLOURS[1], 0.7),
            ],
            y_label=f"{name}, Nm",
        )
        for joint, name in enumerate(check.names)
    ]
    differences = [
        Curve(time, share[:, joint], name, COLOURS[joint % len(COLOURS)], 0.7) for joint, name in enumerate(check.names)
    ]
    tips = len(check.tip_distance) > 0
    panels.append(Panel(differences, "difference", "" if tips else "time, s", "% of largest"))
    if tips:
        far = Curve(check.tip_time, check.tip_distance * 1e6, "", COLOURS[0], 0.8)
        panels.append(Panel([far], "tips", "time, s", "distance, µm"))
    return Plot(panels, height=1.6, share_x=True)
