"""What a program did: its motions with the error of their path, signals and text; as a table, a page, a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.task import SETTLING
from rx90_emulator.cabinet.cell import Cell
from rx90_emulator.cabinet.errors import VplusError
from rx90_emulator.cabinet.plan import Motion
from rx90_emulator.loop.line import followed_accuracy
from rx90_emulator.loop.result import RunResult

_TIMES = ["begin s", "end s", "taken s", "alone s", "null s"]
_COLUMNS = ["line", "motion", *_TIMES, "error mm", "null mm", "joints in degrees"]


class Track(NamedTuple):
    """Where the arm was during a motion.

    Attributes:
        times: s, shape (n,).
        asked: the tool by the set-points, m, shape (n, 3).
        measured: likewise.
    """

    times: Array
    asked: Array
    measured: Array


@dataclass(eq=False)
class ProgramRun:
    """What a program did.

    Attributes:
        cell: where it ran.
        lines: what TYPE showed, with times, s.
        result: the series of the run; None if no time passed, or on running nodes.
        tracks: of the motions, in their order; none without series.
        error: what stopped it; None if it ran to its end.
    """

    cell: Cell
    lines: list[tuple[float, str]] = field(default_factory=list)
    result: RunResult | None = None
    tracks: list[Track] = field(default_factory=list)
    error: VplusError | None = None

    @property
    def motions(self) -> list[Motion]:
        """Return the motions, in their order."""
        return self.cell.queue.done

    def keep(self, result: RunResult) -> None:
        """Take the series of the run, and find where the arm was during each motion."""
        self.result = result
        begins = [motion.began for motion in self.motions]
        period = result.setup.rates.position_period
        for motion in self.motions:
            ended = self.cell.time if math.isnan(motion.ended) else motion.ended
            end = min([ended + SETTLING, *(time for time in begins if time >= ended)])
            rows = slice(round(motion.began / period), round(end / period))
            times = result.times[rows]
            robot = self.cell.arm.with_tool(motion.tool)
            angles = [
                series[rows, 0] for series in (result.slow.reference, result.slow.joint_states)
            ]
            accuracy = followed_accuracy(robot, times, angles[1], times, angles[0])
            motion.error = 1e3 * accuracy.worst if len(accuracy.times) else math.nan
            track = Track(times, *(tip_position(robot.chain, q) for q in angles))
            self.tracks.append(track)
            if not math.isnan(motion.settled):
                end = min(round((ended - motion.began) / period), len(times) - 1)
                motion.nulled = 1e3 * math.dist(track.asked[end], track.measured[end])


def table(run: ProgramRun) -> list[list[str]]:
    """Return the table of motions; null: how long it took behind the last set-point, how far it was off then."""
    rows = [[*_COLUMNS]]
    for motion in run.motions:
        taken = motion.ended - motion.began
        nulling = motion.settled - motion.ended
        times = (motion.began, motion.ended, taken, motion.profile.duration, nulling)
        figures = [f"{time:.3f}" for time in times]
        figures += [f"{way:.4f}" for way in (motion.error, motion.nulled)]
        ends = [
            " ".join(f"{round(joint, 1) + 0.0}" for joint in run.cell.arm.joints(q))
            for q in (motion.start, motion.end)
        ]
        shown = [figure.replace("nan", "-") for figure in figures]
        rows.append([motion.where, motion.kind, *shown, " -> ".join(ends)])
    return rows


def page(run: ProgramRun, name: str) -> str:
    """Return a page on a run."""
    from rx90_common.report.charts import chart
    from rx90_common.report.page import render_page
    from rx90_common.report.style import COLOURS

    speed = chart("", "time, s", "speed of the set-points, mm/s")
    distance = chart("", "time, s", "off the set-point, mm")
    for times, asked, measured in run.tracks:
        rates = np.linalg.norm(np.diff(asked, axis=0), axis=1) / np.diff(times)
        speed.line(times[1:], 1e3 * rates, color=COLOURS[0])
        distance.line(times, 1e3 * np.linalg.norm(measured - asked, axis=1), color=COLOURS[1])
    return render_page(
        __package__ or "",
        "program.html.j2",
        run=run,
        name=name,
        plots=[speed, distance],
        table=table(run),
    )


def draw(run: ProgramRun, file: Path) -> None:
    """Write a picture: where the tool went, seen from above and from the side, by set-points and by measurement."""
    from rx90_common.report.picture import picture
    from rx90_common.report.style import COLOURS

    with picture(file) as figure:
        for panel, up in zip(figure.subplots(1, 2), (1, 2), strict=True):
            for _, *places in run.tracks:
                for place, colour, style in zip(places, COLOURS, "-:", strict=False):
                    panel.plot(1e3 * place[:, 0], 1e3 * place[:, up], color=colour, linestyle=style)
            panel.set(
                xlabel="x, mm", ylabel=f"{'xyz'[up]}, mm", title="set-points solid, measured dotted"
            )
            panel.set_aspect("equal", adjustable="datalim")
