"""The report's plots: loops, break-away, sliding, stick-slip, drift."""

from __future__ import annotations

import numpy as np

from friction_bench.presliding.choice import WITH_BRISTLES, LawScore
from friction_bench.presliding.drift import DriftResult
from friction_bench.presliding.evaluation import PreslidingResult
from friction_bench.presliding.five_laws import LoopBlock
from friction_bench.presliding.sliding import SlidingFriction
from friction_bench.presliding.stick_slip import least_steady_speed
from rx90_common.base.arrays import Array
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dots, Level, Mark, Panel, Plot

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
