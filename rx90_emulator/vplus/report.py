"""The table, the picture and the page of a run of a V+ program."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.vplus.run import ProgramRun

_NOTHING = np.empty(0)


def table_text(run: ProgramRun) -> str:
    """Return the table of motions as text."""
    lines = [f"{'line':<20} {'motion':<8} {'begin s':>8} {'end s':>8} {'taken s':>8} {'alone s':>8} {'error mm':>9}"]
    lines += [
        f"{row.where:<20} {row.kind:<8} {row.begin:8.3f} {row.end:8.3f} {row.end - row.begin:8.3f} {row.asked:8.3f} "
        f"{'-' if math.isnan(row.error) else f'{row.error:.4f}':>9}"
        for row in run.table()
    ]
    return "\n".join(lines)


def tool_speed(run: ProgramRun) -> tuple[Array, Array]:
    """Return times, s, and speeds of the tool's set-points, mm/s, of all motions."""
    times: list[Array] = [_NOTHING]
    speeds: list[Array] = [_NOTHING]
    for motion in run.motions:
        asked, _ = run.paths(motion)
        if len(asked) > 1 and run.result is not None:
            period = run.result.setup.rates.position_period
            times.append(np.asarray(motion.began + np.arange(len(asked) - 1) * period))
            speeds.append(np.asarray(1e3 * np.linalg.norm(np.diff(asked, axis=0), axis=1) / period))
    return np.concatenate(times), np.concatenate(speeds)


def set_point_distance(run: ProgramRun) -> tuple[Array, Array]:
    """Return times, s, and distances of the tool from its set-point, mm, of all motions."""
    times: list[Array] = [_NOTHING]
    distances: list[Array] = [_NOTHING]
    for motion in run.motions:
        asked, measured = run.paths(motion)
        if len(asked) and run.result is not None:
            period = run.result.setup.rates.position_period
            times.append(np.asarray(motion.began + np.arange(len(asked)) * period))
            distances.append(np.asarray(1e3 * np.linalg.norm(measured - asked, axis=1)))
    return np.concatenate(times), np.concatenate(distances)


def page(run: ProgramRun, name: str) -> str:
    """Return a page on a run."""
    from rx90_common.report.charts import chart
    from rx90_common.report.page import render_page
    from rx90_common.report.style import COLOURS

    plots = []
    curves = (("speed of the set-points, mm/s", tool_speed(run)), ("off the set-point, mm", set_point_distance(run)))
    for colour, (label, (times, values)) in zip(COLOURS, curves, strict=False):
        shown = chart("", "time, s", label)
        shown.line(times, values, color=colour)
        plots.append(shown)
    return render_page(__package__ or "", "program.html.j2", run=run, name=name, table=run.table(), plots=plots)


def draw(run: ProgramRun, file: Path) -> None:
    """Write a picture: where the tool went, seen from above and from the side, by set-points and by measurement."""
    from rx90_common.report.picture import picture
    from rx90_common.report.style import COLOURS

    with picture(file) as figure:
        panels = figure.subplots(1, 2)
        for panel, (across, up) in zip(panels, ((0, 1), (0, 2)), strict=True):
            for motion in run.motions:
                asked, measured = run.paths(motion)
                panel.plot(1e3 * asked[:, across], 1e3 * asked[:, up], color=COLOURS[0])
                panel.plot(1e3 * measured[:, across], 1e3 * measured[:, up], color=COLOURS[1], linestyle=":")
            panel.set_xlabel(f"{'xyz'[across]}, mm")
            panel.set_ylabel(f"{'xyz'[up]}, mm")
            panel.set_aspect("equal", adjustable="datalim")
        panels[0].set_title("set-points (solid) and measured (dotted)")
