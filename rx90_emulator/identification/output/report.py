"""What is said of an identified friction, of a validation and of a measured run: tables for the terminal, and reports.

A report is one self-contained HTML page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Band, Curve, Dots, Heat, Level, Panel, Plot
from rx90_emulator.identification.estimates import IdentifiedElement
from rx90_emulator.identification.identify import FrictionIdentification, shown_parameters
from rx90_emulator.identification.presliding.bristle_motion import MOST_MOTIONS, MOST_OF_BAG
from rx90_emulator.identification.presliding.fit import HysteresisLoop
from rx90_emulator.identification.presliding.kinds import DISTINGUISHABLE_SE, ElementKind, decisions
from rx90_emulator.identification.sliding.fit import CurvePoints
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation

_DRAWN_S = 60.0  # s of a run that are drawn: more would blur
_TIME_AXIS = "time since the comparison began, s"
_RECORDED_COLOUR, _PREDICTED_COLOUR, _DIFFERENCE_COLOUR = COLOURS[5], COLOURS[1], COLOURS[6]
_INTERVAL = 1.96  # standard deviations, 95 %
_DRAWN_SHARE = 20  # one part in so many of a micro-oscillation is drawn: more loops would cover each other


def curve_plots(result: FrictionIdentification) -> list[Plot]:
    """Return torque against velocity of each element, with the residuals below."""
    named = zip(result.arm.element_names, result.sliding.curves, strict=True)
    return [_curve_plot(name, curve) for name, curve in named if len(curve.velocity)]


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


def _curve_plot(name: str, curve: CurvePoints) -> Plot:
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
    return slice((_DRAWN_SHARE - 1) * count // (2 * _DRAWN_SHARE), (_DRAWN_SHARE + 1) * count // (2 * _DRAWN_SHARE))


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
    share = np.where(moves, share, np.nan)
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


def identification_summary(result: FrictionIdentification) -> str:
    """Return values with deviations, true ones below, what is not identifiable and why, and the verdicts."""
    width = max(10, *(len(name) + 1 for name in result.arm.element_names))
    parameters, others = shown_parameters(result), []
    lines = [f"{'element':<{width}}" + "".join(f"{name:>22}" for name in parameters)]
    for name, one in zip(result.arm.element_names, result.elements, strict=True):
        if name not in result.told:
            others.append(name)
            continue
        cells = []
        for parameter in parameters:
            estimate = one.estimates.get(parameter)
            if estimate is None:
                cells.append(f"{'1':>22}")
                continue
            text = " +- ".join(estimate.texts()) if estimate.identifiable else "not identifiable"
            cells.append(f"{text:>22}")
        lines.append(f"{name:<{width}}" + "".join(cells))
        if name in result.truth:
            true = (f"{getattr(result.truth[name], parameter):.6g}" for parameter in parameters)
            lines.append(f"{'  true':<{width}}" + "".join(f"{value:>22}" for value in true))
    if others:
        lines.append(f"{', '.join(others)}: nothing identified")
    reasons = [f"not identifiable: {which(names)}: {reason}" for reason, names in result.unidentifiable.items()]
    verdicts = [_verdict(check, result.scope) for check in result.validations]
    return "\n".join([*lines, *reasons, *_kinds(result.kinds), *_given(result), *_fit(result), *verdicts])


def _kinds(kinds: Sequence[ElementKind]) -> list[str]:
    """Return what each kind of bristles misses in micro-oscillations that it was not fitted to, and the decisions."""
    compared = [kind for kind in kinds if kind.choice is not None]
    lines = []
    if compared:
        width = max(10, *(len(kind.element) + 1 for kind in kinds))
        families = [trial.family.name for kind in compared[:1] if kind.choice for trial in kind.choice.trials]
        lines.append("bristles: missed of the friction torque (standard errors behind the best kind)")
        lines.append(f"{'element':<{width}}" + "".join(f"{name:>25}" for name in families))
        for kind in compared:
            assert kind.choice is not None
            cells = [f"{trial.missed:.1%} ({trial.behind:.1f})" for trial in kind.choice.trials]
            lines.append(f"{kind.element:<{width}}" + "".join(f"{cell:>25}" for cell in cells))
    return [*lines, *(f"bristles of {names}: {text}" for names, text in decisions(kinds))]


def _given(result: FrictionIdentification) -> list[str]:
    """Return in a line whose bristles are the fallback's, of another kind than LuGre's."""
    names = ", ".join(result.with_given_bristles)
    return [f"bristles of {names}: as c0 those of {result.fallback_name}, assumed"] if names else []


def _fit(result: FrictionIdentification) -> list[str]:
    """Return how well the curves fit, and what was used of each bag of sweeps."""
    names = result.arm.element_names
    named = zip(names, result.sliding.quality, strict=True)
    quality = [line for name, one in named if one is not None for line in one.lines(name)]
    zeros = result.sliding.zeros
    noticed = [zeros.text] if zeros is not None and zeros.text else []
    return [*quality, *noticed, *(f"{use.bag.path}: {use.text(names)}" for use in result.sliding.usage)]


def check_summary(checks: Sequence[Validation]) -> str:
    """Return a table of the joints and the verdict for each bag that a friction file was held against."""
    lines = []
    for check in checks:
        width = max(8, *(len(name) + 1 for name in check.names))
        lines.append(f"{'joint':<{width}}{'RMS, Nm':>10}{'of torque':>11}{'worst, Nm':>11}{'of largest':>12}")
        rows = zip(check.names, check.rms, check.rms_share, check.worst, check.worst_share, strict=True)
        lines += [
            f"{name:<{width}} {_number(rms, 9)} {_percent(share):>10} {_number(worst, 10)} {_percent(worst_share):>11}"
            for name, rms, share, worst, worst_share in rows
        ]
        if check.zeros is not None and check.zeros.text:
            lines.append(check.zeros.text)
        lines.append(_verdict(check))
    return "\n".join(lines)


def which(lacking: Mapping[str, Sequence[str]]) -> str:
    """Return parameters with the elements that lack them, elements that lack the same ones together."""
    together: dict[str, list[str]] = {}
    for name, parameters in lacking.items():
        together.setdefault(", ".join(parameters), []).append(name)
    return "; ".join(f"{parameters} of {', '.join(names)}" for parameters, names in together.items())


def _verdict(check: Validation, scope: str = "") -> str:
    limits = check.tolerances
    joint = int(np.nanargmax(check.rms_share))
    worst = int(np.nanargmax(check.worst_share))
    tip = (
        "no set-points, so no tip path"
        if not len(check.tip_distance)
        else f"tip worst {check.tip_worst * 1e6:.2f} um (limit {limits.tip * 1e6:g}), RMS {check.tip_rms * 1e6:.2f} um"
    )
    return (
        f"validation {check.source}: {'confirmed' if check.passed else 'NOT CONFIRMED'}{scope}: torque RMS "
        f"{check.rms_share[joint]:.2%} ({check.names[joint]}, limit {limits.torque:.0%}), worst "
        f"{check.worst_share[worst]:.2%} ({check.names[worst]}, limit {limits.worst_torque:.0%}); {tip}"
    )


def check_page(checks: Sequence[Validation], friction_file: str, now: datetime | None = None) -> str:
    """Return the text of the page on a friction file that was held against bags.

    Args:
        checks: one for each bag.
        friction_file: name of the file.
        now: date of the comparison; by default the present.
    """
    return render_page(
        "rx90_emulator.identification.output",
        "friction_check.html.j2",
        checks=_drawn(checks),
        friction_file=friction_file,
        date=_date(now),
    )


def _drawn(checks: Sequence[Validation]) -> list[tuple[Validation, str, Plot]]:
    return [(check, Path(check.source).name, validation_plot(check)) for check in checks]


def _date(now: datetime | None) -> str:
    return (now or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC")


def report_page(result: FrictionIdentification, friction_file: str, now: datetime | None = None) -> str:
    """Return the page's text.

    Args:
        result: what was identified.
        friction_file: name of the file with the values.
        now: date of the identification; by default the present.
    """
    named = list(zip(result.arm.element_names, result.elements, strict=True))
    compared = [kind for kind in result.kinds if kind.choice is not None]
    own_bristles = [kind.element for kind in compared if kind.trial is not None]
    return render_page(
        "rx90_emulator.identification.output",
        "identification.html.j2",
        elements=[pair for pair in named if pair[0] in result.told],
        others=[name for name in result.arm.element_names if name not in result.told],
        truth=result.truth,
        scope=result.scope,
        assumed=[(which(names), reason) for reason, names in result.unidentifiable.items()],
        parameters=shown_parameters(result),
        units=FRICTION_UNITS,
        fallback=result.fallback_name,
        fading=[(name, one.element.omega_d) for name, one in named if math.isfinite(one.element.omega_d)],
        shared=result.arm.element_names[len(result.arm.names) :],
        checks=_drawn(result.validations),
        friction_file=friction_file,
        date=_date(now),
        bags=result.bags,
        quality=[pair for pair in zip(result.arm.element_names, result.sliding.quality, strict=True) if pair[1]],
        usage=[(use, use.text(result.arm.element_names)) for use in result.sliding.usage],
        zeros=result.sliding.zeros,
        trends=drift_plots(result),
        plateaus=result.sliding.plateaus,
        motions=result.presliding.motions,
        curves=curve_plots(result),
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops if loop.joint not in own_bristles],
        own_bristles=own_bristles,
        compared=compared,
        decisions=decisions(result.kinds),
        given=result.with_given_bristles,
        numbers=[(name, *row) for name, one in named if not one.given_bristles for row in _own_numbers(one)],
        families=[trial.family.name for kind in compared[:1] if kind.choice for trial in kind.choice.trials],
        most_motions=MOST_MOTIONS,
        most_of_bag=MOST_OF_BAG,
        distinguishable_se=DISTINGUISHABLE_SE,
        kind_loops=[kind_plot(kind) for kind in compared],
        correlations=correlation_plots(result),
    )


def _own_numbers(one: IdentifiedElement) -> list[tuple[str, str, str]]:
    """Return name, value and deviation of the numbers of an element's own bristles; no deviation where assumed."""
    found = []
    for name, estimate in one.estimates.items():
        if name.startswith("bristles."):
            value, deviation = estimate.texts() if estimate.identifiable else (f"{one.value(name):.4g}", "")
            found.append((name.removeprefix("bristles."), value, deviation))
    return found


def _measured_torque_plot(result: MeasuredComparison) -> Plot:
    """Show measured and simulated torque and their difference, a panel for each joint."""
    shown, time = _window(result)
    difference = np.where(result.compared, result.simulated_torque - result.torque, np.nan)
    panels = [
        Panel(
            [
                Curve(time, result.torque[shown, joint], "measured", _RECORDED_COLOUR, 1.8),
                Curve(time, result.simulated_torque[shown, joint], "simulated", _PREDICTED_COLOUR, 0.8),
                Curve(time, difference[shown, joint], "difference, where it moves", _DIFFERENCE_COLOUR, 0.6),
            ],
            name,
            _TIME_AXIS if joint == len(result.names) - 1 else "",
            "Nm",
        )
        for joint, name in enumerate(result.names)
    ]
    return Plot(panels, height=1.7, share_x=True)


def _measured_position_plot(result: MeasuredComparison) -> Plot:
    """Show positions measured and simulated, and their difference beside them, a row for each joint."""
    shown, time = _window(result)
    panels = []
    for joint, name in enumerate(result.names):
        measured, simulated = result.position[shown, joint], result.simulated_position[shown, joint]
        both = [
            Curve(time, measured, "measured", _RECORDED_COLOUR, 1.8),
            Curve(time, simulated, "simulated", _PREDICTED_COLOUR, 0.8),
        ]
        apart = Curve(time, 1e3 * (simulated - measured), "simulated - measured", _DIFFERENCE_COLOUR, 0.7)
        below = _TIME_AXIS if joint == len(result.names) - 1 else ""
        panels += [Panel(both, name, below, "rad"), Panel([apart], name, below, "mrad")]
    return Plot(panels, columns=2, height=1.7, share_x=True)


def _window(result: MeasuredComparison) -> tuple[slice, Array]:
    """Return which samples are drawn, and their times, s."""
    time = result.time - result.time[0]
    shown = slice(0, int(np.searchsorted(time, _DRAWN_S, side="right")))
    return shown, time[shown]


_MEASURED_COLUMNS = (
    f"{'torque RMS':>12}{'of measured':>13}{'worst':>11}{'of largest':>12}{'compared':>10}"
    f"{'position RMS':>15}{'worst':>12}"
)


def measured_summary(result: MeasuredComparison) -> str:
    """Return set-points, filters and lag, a row for each joint, and the verdict."""
    width = max(8, *(len(name) + 1 for name in result.names))
    rows = zip(
        result.names,
        result.torque_rms,
        result.torque_share,
        result.torque_worst,
        result.worst_share,
        result.compared_share,
        result.position_rms,
        result.position_worst,
        strict=True,
    )
    table = [
        f"{name:<{width}} {_number(rms, 8)} Nm {_percent(share):>12} {_number(worst, 7)} Nm {_percent(worst_share):>11}"
        f"{part:>10.0%}{1e3 * position:>10.3f} mrad{1e3 * farthest:>7.3f} mrad"
        for name, rms, share, worst, worst_share, part, position, farthest in rows
    ]
    return "\n".join(
        [*_measured_facts(result), f"{'joint':<{width}}{_MEASURED_COLUMNS}", *table, _measured_verdict(result)]
    )


def _measured_facts(result: MeasuredComparison) -> tuple[str, ...]:
    """Return what was simulated and how it was compared, a sentence each."""
    bands, which = result.bandwidths, "later" if result.lag >= 0.0 else "earlier"
    return (
        f"set-points: {result.setpoints}",
        f"torques and positions are compared below {bands.torque:.3g} Hz ({bands.reason})",
        f"the simulated motion is {abs(result.lag) * 1e3:.3f} ms {which}, which is taken out",
        *(
            f"{name}'s motor is at its limit in {share:.1%} of the simulated time"
            for name, share in zip(result.names, result.saturated, strict=True)
            if share > 0.0
        ),
        *result.remarks,
    )


def _measured_verdict(result: MeasuredComparison) -> str:
    """Return the verdict, with what decides and its limits."""
    limits = result.tolerances
    share = [-1.0 if math.isnan(one) else float(one) for one in result.torque_share]
    joint, farthest = share.index(max(share)), int(result.position_worst.argmax())
    return (
        f"{result.source.path}: {'agrees' if result.passed else 'DOES NOT AGREE'}: torque RMS of all joints "
        f"{result.total_share:.2%} (limit {limits.total_torque:.3g}), largest {max(share):.2%} "
        f"({result.names[joint]}, limit {limits.torque:.3g}); position "
        f"{1e3 * result.position_worst[farthest]:.3f} mrad ({result.names[farthest]}, limit "
        f"{1e3 * limits.position:.4g} mrad)"
    )


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2%}"


def _number(value: float, width: int) -> str:
    return f"{'-':>{width}}" if math.isnan(value) else f"{value:>{width}.3f}"


def measured_page(result: MeasuredComparison, files: tuple[str, ...], date: datetime) -> str:
    """Return the page's text.

    Args:
        result: of the comparison.
        files: that the robot was read from.
        date: of the comparison.
    """
    return render_page(
        "rx90_emulator.identification.output",
        "measured.html.j2",
        result=result,
        files=files,
        date=date.strftime("%Y-%m-%d %H:%M UTC"),
        facts=_measured_facts(result),
        verdict=_measured_verdict(result),
        torques=_measured_torque_plot(result),
        positions=_measured_position_plot(result),
    )
