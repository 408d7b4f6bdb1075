"""The result of a campaign: on the terminal, as an HTML page, and as YAML."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from friction_bench.presliding.laws import LUGRE, Choice, LoopBlock
from friction_bench.presliding.sliding import (
    DriftResult,
    Pull,
    SlidingFriction,
    SlidingReadings,
    by_rate,
    least_steady_speed,
)
from friction_bench.rig.rig_file import Rig
from rx90_common.base.config import yaml_text
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dots, Level, Mark, Panel, Plot

VISIBLE_COUNTS = 5.0
"""Counts of presliding from which loops have a shape."""
_MAX_LOOPS = 4
SCALE = "torques: common to all is a relative standard uncertainty of {:.2g} %, of torque scale and gear efficiency"


@dataclass(eq=False)
class PreslidingResult:
    """The result of a campaign; parts are None or empty if they were not run, or have no result.

    Attributes:
        origin: of the readings, in words.
        rig: the rig.
        deflection: of the joint up to break-away, rad, on the slowest ramps; None if it does not break away.
        break_away: the torque's rate, Nm/s, and the largest friction before sliding, Nm, of each ramp; backward ones
            separately.
        failures: the reason for each part that was run without a result, one line each.
    """

    origin: str
    rig: Rig
    deflection: float | None = None
    break_away: list[tuple[float, float]] = field(default_factory=list)
    break_away_backward: list[tuple[float, float]] = field(default_factory=list)
    sliding: SlidingFriction | None = None
    sliding_backward: SlidingFriction | None = None
    readings: SlidingReadings | None = None
    readings_backward: SlidingReadings | None = None
    blocks: list[LoopBlock] = field(default_factory=list)
    choice: Choice | None = None
    pulls: list[Pull] = field(default_factory=list)
    drift: DriftResult | None = None
    failures: list[str] = field(default_factory=list)


def _loops_plot(result: PreslidingResult) -> Plot:
    """Show the first blocks of loops, torque over angle, with the predictions of the laws with bristles."""
    panels = []
    for k, block in enumerate(result.blocks[:_MAX_LOOPS]):
        angle = 1e3 * (block.angle[block.readings] - block.angle[block.readings[0]])
        marks: list[Mark] = []
        if result.choice is not None:
            shown = [score for score in result.choice.scores if score.law.bristles is not None]
            for colour, score in zip(COLOURS, shown, strict=False):
                (torque,) = score.law.predict(score.values, result.choice.sliding, [block])
                marks.append(Curve(angle, torque, score.law.name, colour, 0.9))
        marks.append(Curve(angle, block.torque, "measured", INK, 0.6, dots=True))
        panels.append(Panel(marks, f"block {k + 1}", "angle since the block's slide, mrad", "torque, Nm"))
    return Plot(panels, columns=2, height=3.0)


def _pulls_plot(result: PreslidingResult) -> Plot:
    """Show stick-slip over speed and stiffness, and where linear stability predicts it."""
    marks: list[Mark] = []
    for slips, label, colour in ((True, "sticks and slips", COLOURS[1]), (False, "slides", COLOURS[0])):
        chosen = np.array([pull[:2] for pull in result.pulls if pull.sticks_and_slips is slips])
        if chosen.size:
            marks.append(Dots(chosen[:, 0], chosen[:, 1], label, colour))
    if result.sliding is not None and result.sliding.turning_speed is not None:
        label = "friction rises with speed from here"
        marks.append(Level(result.sliding.turning_speed, label, GREY, "dashed", upright=True))
    if result.sliding is not None and result.choice is not None:
        tried = [pull.stiffness for pull in result.pulls]
        stiffness = np.geomspace(min(tried), max(tried), 15)
        lugre = next(score for score in result.choice.scores if score.law is LUGRE)
        joint = LUGRE.element(lugre.values, result.choice.sliding), result.sliding.inertia
        fastest = 2.0 * max(pull.speed for pull in result.pulls)
        least = [least_steady_speed(*joint, float(one), result.rig.tick, fastest) for one in stiffness]
        marks.append(Curve(np.array(least), stiffness, "steady sliding is stable from here", INK, 1.0))
    return Plot([Panel(marks, "", "speed, rad/s", "stiffness, Nm/rad")], height=2.8)


def drift_plot(drift: DriftResult) -> Plot:
    """Show the joint's position after each small cycle, and the position predicted by LuGre's law."""
    cycles = np.arange(drift.position.size, dtype=np.float64)
    marks: list[Mark] = []
    if drift.by_lugre is not None:
        least, largest = (counts * cycles for counts in drift.by_lugre)
        marks.append(Curve(cycles, least, "LuGre's law, least", GREY, 1.0, "dashed"))
        marks.append(Curve(cycles, largest, "LuGre's law, largest", GREY, 1.0, "dotted"))
    marks.append(Curve(cycles, drift.position - drift.position[0], "measured", COLOURS[1], 1.2))
    return Plot([Panel(marks, "", "small cycle", "drift, counts")], height=2.8)


def _resolution(result: PreslidingResult) -> tuple[str, dict[str, float]]:
    """Return the encoder's and converter's resolution of this joint's presliding, in words and as an entry."""
    count, code = result.rig.joint_step, result.rig.joint_code
    text = f"a count is {1e6 * count:.1f} urad and a code {1e3 * code:.1f} mNm at the joint"
    entry = {"count_rad": count, "code_nm": code}
    if result.deflection is None:
        return f"{text}; it has not broken away", entry
    entry["presliding_counts"] = counts = result.deflection / count
    note = "" if counts >= VISIBLE_COUNTS else ": too few to see loops"
    bends = f"it bends by {1e6 * result.deflection:.0f} urad, {counts:.1f} counts, up to break-away{note}"
    return f"{text}; {bends}", entry


def _drift_text(drift: DriftResult) -> str:
    """Return the drift and the verdict, in words."""
    mean, least, largest = drift.drift
    law = "no swing is seen"
    if drift.by_lugre is not None:
        low, high = drift.by_lugre
        law = f"LuGre's law {low:.3g} to {high:.3g}, swing {drift.swing:.3g}"
    return f"{mean:.3g} counts a cycle [{least:.3g}, {largest:.3g}], {law}: {drift.verdict.value} ({drift.reason})"


def _add_directions(
    result: PreslidingResult, lines: list[str], document: dict[str, Any], plots: dict[str, Plot]
) -> None:
    """Add break-away and sliding of each direction to the lines for the terminal, the document and the plots."""
    common = result.rig.joint_scale_uncertainty
    ramps = {"": result.break_away, " backward": result.break_away_backward}
    marks: list[Mark] = []
    for colour, (way, torques) in zip(COLOURS[1:], ramps.items(), strict=False):
        if not torques:
            continue
        rows = by_rate(torques)
        lines.append(f"break-away{way}: " + ", ".join(f"{m:.3f} ± {e:.3f} Nm at {r:.3g} Nm/s" for r, m, e in rows))
        names: tuple[str, ...] = ("rate_nm_s", "torque_nm", "standard_error_nm", "standard_uncertainty_nm")
        document[f"break_away{way}".replace(" ", "_")] = [
            dict(zip(names, (*row, math.hypot(row[2], common * row[1])), strict=True)) for row in rows
        ]
        each, (rates, means, errors) = np.array(torques), np.array(rows).T
        marks.append(Dots(each[:, 0], each[:, 1], f"each ramp{way}", GREY))
        marks.append(Dots(rates, means, f"mean and standard error{way}", colour, errors))
    if marks:
        panel = Panel(marks, "", "rate of the torque, Nm/s", "break-away, Nm", x_scale="log")
        plots["break_away"] = Plot([panel], height=2.8)
    sweeps = {
        "": (result.sliding, result.readings),
        " backward": (result.sliding_backward, result.readings_backward),
    }
    marks = []
    for colour, (way, (s, readings)) in zip(COLOURS, sweeps.items(), strict=False):
        if s is None or readings is None:
            continue
        lines.append(
            f"sliding{way}: tau_c {s.tau_c:.3f} Nm, tau_s {s.tau_s:.3f} Nm, omega_s {s.omega_s:.3f} rad/s, "
            f"c2 {s.c2:.3f} Nm s/rad, inertia {s.inertia:.3f} kg m2"
        )
        names = ("tau_c", "tau_s", "omega_s", "c2", "inertia")
        document[f"sliding{way}".replace(" ", "_")] = {name: float(f"{getattr(s, name):.5g}") for name in names}
        speed = np.linspace(0.0, 1.02 * float(readings.speed.max()), 300)
        rest = readings.torque - s.inertia * readings.acceleration
        marks.append(Dots(readings.speed, rest, f"readings{way}", colour))
        marks.append(Curve(speed, s.torque(speed), f"fitted{way}", INK, 1.2, "dashed" if way else "solid"))
    if marks:
        plots["sliding"] = Plot([Panel(marks, "", "speed of the joint, rad/s", "friction, Nm")], height=2.8)


def write_result(out: Path, result: PreslidingResult) -> None:
    """Print the results and write report.html and estimates.yaml, joint side, in a folder.

    Raises:
        Rx90Error: if a file cannot be written; the results are printed before.
    """
    resolution, entry = _resolution(result)
    common = result.rig.joint_scale_uncertainty
    lines, plots = [f"resolution: {resolution}", SCALE.format(100.0 * common)], dict[str, Plot]()
    document: dict[str, Any] = {
        "rig": result.rig.file.name, "resolution": entry, "relative_uncertainty_of_all_torques": float(f"{common:.4g}"),
    }  # fmt: skip
    if result.blocks:
        plots["loops"] = _loops_plot(result)
    _add_directions(result, lines, document, plots)
    if result.choice is not None:
        choice = result.choice
        lines.append(f"{'law':22}{'loops, mNm RMS':>16}{'sliding, mNm RMS':>18}")
        for score in choice.scores:
            loops, sliding = (1e3 * float(squares.mean() ** 0.5) for squares in (score.loops, score.sliding))
            lines.append(f"{score.law.name:22}{loops:16.1f}{sliding:18.1f}  {score.refuted or 'not refuted'}")
        lines.append(f"law of friction: {choice.text}")
        refuted = {score.law.name: score.refuted for score in choice.scores if score.refuted}
        document["law"] = {"verdict": choice.text, "left": [law.name for law in choice.remaining], "refuted": refuted}
        fitted = {score.law.name: score.values[0] for score in choice.scores if score.law.bristles is not None}
        stiffness = {
            law.name: float(f"{np.exp(fitted[law.name]):.4g}") for law in choice.remaining if law.name in fitted
        }
        lines += [f"stiffness c0 of {name}: {value:g} Nm/rad" for name, value in stiffness.items()]
        document["law"]["c0_nm_per_rad"] = stiffness
    if result.pulls:
        slips = [f"{pull.speed:.3f} rad/s at {pull.stiffness:g} Nm/rad" for pull in result.pulls if pull[2]]
        lines.append(f"stick-slip: {len(slips)} of {len(result.pulls)}" + (f": {', '.join(slips)}" if slips else ""))
        document["stick_slip"] = [pull._asdict() for pull in result.pulls]
        plots["pulls"] = _pulls_plot(result)
    if result.drift is not None:
        drift = result.drift
        lines.append(f"drift: {_drift_text(drift)}")
        document["drift"] = {
            "verdict": drift.verdict.value,
            "counts_per_cycle": list(drift.drift),
            "swing_counts": drift.swing,
            "lugre_ratio": list(drift.expected),
        }
        plots["drift"] = drift_plot(drift)
    print("\n".join([*lines, *(f"not used: {reason}" for reason in result.failures)]))
    page = render_page(
        "friction_bench.presliding",
        "presliding_report.html.j2",
        result=result,
        plots=plots,
        resolution=resolution,
        scale=SCALE.format(100.0 * common),
        drift=_drift_text(result.drift) if result.drift is not None else "",
    )
    write_text(out / "report.html", page)
    write_text(out / "estimates.yaml", yaml_text({**document, "not_used": list(result.failures)}))
