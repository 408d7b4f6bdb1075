"""The result of a campaign: on the terminal, as an HTML page, and as YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from friction_bench.presliding.choice import WITH_BRISTLES, LawScore
from friction_bench.presliding.drift import DriftResult
from friction_bench.presliding.evaluation import PreslidingResult
from friction_bench.presliding.five_laws import LoopBlock
from friction_bench.presliding.sliding import SlidingFriction
from friction_bench.presliding.stick_slip import least_steady_speed
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dots, Level, Mark, Panel, Plot

SEEN = 5.0
"""Counts of presliding from which loops have a shape."""
_MOST_LOOPS = 4
_ANGLE = "angle since the block's slide, mrad"
_TORQUE = "torque, Nm"


def loops_plot(result: PreslidingResult) -> Plot:
    """Show the first blocks of loops, torque over angle, with what the laws with bristles predict from the angle."""
    panels = [
        Panel(_loop_marks(result, block), f"block {k + 1}", _ANGLE, _TORQUE)
        for k, block in enumerate(result.blocks[:_MOST_LOOPS])
    ]
    return Plot(panels, columns=2, height=3.0)


def _loop_marks(result: PreslidingResult, block: LoopBlock) -> list[Mark]:
    angle = 1e3 * (block.angle[block.readings] - block.angle[block.readings[0]])
    marks: list[Mark] = []
    choice = result.choice
    if choice is not None:
        shown: list[LawScore] = [score for score in choice.scores if score.law in WITH_BRISTLES]
        for colour, score in zip(COLOURS, shown, strict=False):
            torque = score.law.predict(score.values, choice.sliding, block)
            marks.append(Curve(angle, torque, score.law.name, colour, 0.9))
    return [*marks, Curve(angle, block.torque, "measured", INK, 0.6, dots=True)]


def break_away_plot(result: PreslidingResult) -> Plot:
    """Show the largest friction before sliding over the torque's rate."""
    assert result.break_away is not None
    rates, means, errors = result.break_away.by_rate()
    marks: list[Mark] = [
        Dots(result.break_away.rate, result.break_away.torque, "each ramp", GREY),
        Dots(rates, means, "mean and standard error", COLOURS[1], errors),
    ]
    return Plot([Panel(marks, "", "rate of the torque, Nm/s", "break-away, Nm", x_scale="log")], height=2.8)


def sliding_plot(result: PreslidingResult) -> Plot:
    """Show friction over speed with the fitted curve."""
    readings, friction = result.readings, result.sliding
    assert readings is not None
    assert friction is not None
    speed = np.linspace(0.0, 1.02 * float(readings.speed.max()), 300)
    torque = readings.torque - friction.inertia * readings.acceleration
    marks: list[Mark] = [
        Dots(readings.speed, torque, "readings", COLOURS[0]),
        Curve(speed, friction.torque(speed), "fitted", INK, 1.2),
    ]
    return Plot([Panel(marks, "", "speed of the joint, rad/s", "friction, Nm")], height=2.8)


def pulls_plot(result: PreslidingResult) -> Plot:
    """Show where the joint sticks and slips over speed and stiffness, and where linear stability says that it does."""
    pulls = result.pulls
    marks: list[Mark] = []
    for slips, label, colour in ((True, "sticks and slips", COLOURS[1]), (False, "slides", COLOURS[0])):
        chosen = [pull for pull in pulls if pull.sticks_and_slips is slips]
        if chosen:
            speed = np.array([pull.speed for pull in chosen])
            marks.append(Dots(speed, np.array([pull.stiffness for pull in chosen]), label, colour))
    turn = None if result.sliding is None else turning_speed(result.sliding)
    if turn is not None:
        marks.append(Level(turn, "friction rises with speed from here", GREY, "dashed", upright=True))
    lugre = None if result.choice is None else result.choice.lugre
    if lugre is not None and result.sliding is not None:
        stiffness = np.geomspace(min(pull.stiffness for pull in pulls), max(pull.stiffness for pull in pulls), 15)
        fastest = 2.0 * max(pull.speed for pull in pulls)
        least = [
            least_steady_speed(lugre, result.sliding.inertia, float(one), pulls[0].trace.tick, fastest)
            for one in stiffness
        ]
        marks.append(Curve(np.array(least), stiffness, "steady sliding is stable from here", INK, 1.0))
    return Plot([Panel(marks, "", "speed, rad/s", "stiffness, Nm/rad")], height=2.8)


def turning_speed(friction: SlidingFriction) -> float | None:
    """Return the speed, rad/s, at which steady friction has its minimum; None where it rises from rest."""
    fall = (friction.tau_s - friction.tau_c) / friction.omega_s
    if friction.c2 <= 0.0 or fall <= friction.c2:
        return None
    return float(friction.omega_s * np.log(fall / friction.c2))


def drift_plot(drift: DriftResult) -> Plot:
    """Show where the joint stands after each small cycle, and where LuGre's law would have it."""
    position: Array = drift.position - drift.position[0]
    marks: list[Mark] = []
    if drift.by_lugre is not None:
        least, largest = (counts * drift.cycles for counts in drift.by_lugre)
        marks.append(Curve(drift.cycles, least, "LuGre's law, least", GREY, 1.0, "dashed"))
        marks.append(Curve(drift.cycles, largest, "LuGre's law, largest", GREY, 1.0, "dotted"))
    marks.append(Curve(drift.cycles, position, "measured", COLOURS[1], 1.2))
    return Plot([Panel(marks, "", "small cycle", "drift, counts")], height=2.8)


def resolution_text(result: PreslidingResult) -> str:
    """Return in words what encoder and converter resolve of this joint's presliding."""
    steps = f"a count is {1e6 * result.step:.1f} urad and a code {1e3 * result.code:.1f} mNm at the joint"
    if result.deflection is None or result.deflection_counts is None:
        return f"{steps}; it has not broken away"
    seen = "" if result.deflection_counts >= SEEN else ": too few to see loops"
    bends = f"{1e6 * result.deflection:.0f} urad, {result.deflection_counts:.1f} counts"
    return f"{steps}; it bends by {bends}, up to break-away{seen}"


def result_text(result: PreslidingResult) -> str:
    """Return the results for the terminal."""
    lines = [f"resolution: {resolution_text(result)}"]
    if result.break_away is not None:
        rates, means, errors = result.break_away.by_rate()
        pairs = zip(rates, means, errors, strict=True)
        lines.append("break-away: " + ", ".join(f"{m:.3f} ± {e:.3f} Nm at {r:.3g} Nm/s" for r, m, e in pairs))
    if result.sliding is not None:
        s = result.sliding
        lines.append(
            f"sliding: tau_c {s.tau_c:.3f} Nm, tau_s {s.tau_s:.3f} Nm, omega_s {s.omega_s:.3f} rad/s, "
            f"c2 {s.c2:.3f} Nm s/rad, inertia {s.inertia:.3f} kg m2"
        )
    if result.choice is not None:
        lines.append(f"{'law':22}{'loops, mNm RMS':>16}{'sliding, mNm RMS':>18}")
        for score in result.choice.scores:
            loops, sliding = (1e3 * float((part**2).mean() ** 0.5) for part in (score.loops, score.sliding))
            lines.append(f"{score.law.name:22}{loops:16.1f}{sliding:18.1f}  {score.refuted or 'not refuted'}")
        lines.append(f"law of friction: {result.choice.text}")
    if result.pulls:
        slips = [
            f"{pull.speed:.3f} rad/s at {pull.stiffness:g} Nm/rad" for pull in result.pulls if pull.sticks_and_slips
        ]
        lines.append(f"stick-slip: {len(slips)} of {len(result.pulls)}" + (f": {', '.join(slips)}" if slips else ""))
    if result.drift is not None:
        lines.append(f"drift: {drift_text(result)}")
    return "\n".join([*lines, *(f"not used: {reason}" for reason in result.failures)])


def drift_text(result: PreslidingResult) -> str:
    """Return the drift and what it says, in words."""
    drift = result.drift
    assert drift is not None
    mean, least, largest = drift.drift
    law = "no swing is seen"
    if drift.by_lugre is not None:
        low, high = drift.by_lugre
        law = f"LuGre's law {low:.3g} to {high:.3g}, swing {drift.swing[0]:.3g}"
    return f"{mean:.3g} counts a cycle [{least:.3g}, {largest:.3g}], {law}: {drift.verdict.value} ({drift.reason})"


def write_html(path: Path, result: PreslidingResult, rig: Rig) -> None:
    """Write the page.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    plots = {}
    if result.blocks:
        plots["loops"] = loops_plot(result)
    if result.break_away is not None:
        plots["break_away"] = break_away_plot(result)
    if result.sliding is not None:
        plots["sliding"] = sliding_plot(result)
    if result.pulls:
        plots["pulls"] = pulls_plot(result)
    if result.drift is not None:
        plots["drift"] = drift_plot(result.drift)
    page = render_page(
        "friction_bench.presliding",
        "presliding_report.html.j2",
        result=result,
        rig=rig,
        plots=plots,
        resolution=resolution_text(result),
        drift=drift_text(result) if result.drift is not None else "",
        turn=turning_speed(result.sliding) if result.sliding is not None else None,
    )
    write_text(path, page)


def write_estimates(path: Path, result: PreslidingResult, rig: Rig) -> None:
    """Write every estimate as YAML, joint side.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    document: dict[str, Any] = {
        "rig": rig.file.name,
        "resolution": {"count_rad": result.step, "code_nm": result.code},
    }
    if result.deflection_counts is not None:
        document["resolution"]["presliding_counts"] = result.deflection_counts
    if result.break_away is not None:
        rates, means, errors = result.break_away.by_rate()
        document["break_away"] = [
            {"rate_nm_s": float(r), "torque_nm": float(m), "standard_error_nm": float(e)}
            for r, m, e in zip(rates, means, errors, strict=True)
        ]
    if result.sliding is not None:
        names = ("tau_c", "tau_s", "omega_s", "c2", "inertia")
        document["sliding"] = {name: float(f"{getattr(result.sliding, name):.5g}") for name in names}
    if result.choice is not None:
        document["law"] = {
            "verdict": result.choice.text,
            "left": list(result.choice.left),
            "refuted": {score.law.name: score.refuted for score in result.choice.scores if score.refuted},
        }
    if result.pulls:
        document["stick_slip"] = [
            {"speed": float(pull.speed), "stiffness": float(pull.stiffness), "sticks_and_slips": pull.sticks_and_slips}
            for pull in result.pulls
        ]
    if result.drift is not None:
        drift = result.drift
        document["drift"] = {
            "verdict": drift.verdict.value,
            "counts_per_cycle": [float(value) for value in drift.drift],
            "swing_counts": float(drift.swing[0]),
            "lugre_ratio": [float(value) for value in drift.expected],
        }
    document["not_used"] = list(result.failures)
    write_text(path, yaml_text(document))
