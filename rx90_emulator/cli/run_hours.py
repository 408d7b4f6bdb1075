"""What `rx90_run --hours` does: a line there and back for so long, and what temperature makes of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import one_line, plain
from rx90_emulator.cli.progress import progress_bar

if TYPE_CHECKING:
    from rx90_common.report.plot import Plot
    from rx90_emulator.loop.setup import Setup
    from rx90_emulator.loop.working_day import RepeatedLine

_ROWS = 12  # of the tables
_OTHERS = (
    "trajectory", "from_bag", "initial_position", "start_time", "output", "arrays", "storage", "decimation",
    "slow_only", "temperature_rate",
)  # fmt: skip


def check_hours(options: argparse.Namespace) -> None:
    """Refuse options that do not go with --hours, and those that go with it alone.

    Raises:
        ConfigError: naming the option.
    """
    if options.hours is None and options.plot is None:
        return
    from rx90_common.report.picture import PICTURES

    if options.hours is None:
        raise ConfigError("--plot without --hours; accepted: with --hours; rx90_bag plot draws bags")
    for name in _OTHERS:
        given = getattr(options, name)
        if given is not None and given is not False:  # 0 is given, too
            raise ConfigError(f"--{name.replace('_', '-')} with --hours; accepted: --task and --plot")
    if options.plot is not None and options.plot.suffix.lower() not in PICTURES:
        raise ConfigError(f"--plot {plain(options.plot)}; accepted: a file with {', '.join(PICTURES)}")
    if options.substeps is not None:
        raise ConfigError(f"--substeps {options.substeps} with --hours; accepted: left out")


def run_hours(setup: Setup, options: argparse.Namespace) -> None:
    """Run the task for hours, print how it goes, draw it where asked for; who interrupts has what was done.

    Raises:
        Rx90Error: as `repeat_line`; also if the plot cannot be written.
    """
    from rx90_common.description.robot_files import RobotFiles
    from rx90_controller.lines.task import load_task
    from rx90_emulator.loop.working_day import ThermalRun

    day = ThermalRun(setup, load_task(RobotFiles.of_options(options).required("task")))
    try:
        total = day.whole_cycles(3600.0 * options.hours)
    except ConfigError as error:
        raise ConfigError(f"--hours {options.hours:g}: {error}") from error
    try:
        with progress_bar("cycles") as tell:
            while day.advance(total):
                tell(day.done, total)
            tell(total, total)
    finally:  # also for who interrupts
        if day.done:
            _show(day.result(), day.done, options.plot)


def _show(result: RepeatedLine, cycles: int, plot: Path | None) -> None:
    count = len(result.times)
    print(f"{cycles} times there and back in {cycles * result.cycle / 3600.0:.3g} h, of which {count} were simulated")
    rows = np.unique(np.linspace(0, count - 1, _ROWS).round().astype(int))
    names = result.setup.friction.names
    head = "".join(f"{name:>11}" for name in names)
    warm = [element.temperature is not None for element in result.setup.friction.elements]
    print(f"\n{'':8}{'path error, mm':>18}  temperature of the joints, °C\n{'h':>8}{'worst':>9}{'RMS':>9}{head}")
    for i in rows:
        degrees = "".join(
            f"{t:11.1f}" if known else f"{'-':>11}" for t, known in zip(result.temperatures[i], warm, strict=True)
        )
        print(f"{result.times[i] / 3600.0:8.3f}{result.worst[i] * 1e3:9.4f}{result.rms[i] * 1e3:9.4f}{degrees}")
    print(f"\n{'':8}{'':18}  mean friction torque, Nm\n{'h':>8}{'':18}{head}")
    for i in rows:
        torques = "".join(f"{torque:11.3f}" for torque in result.friction[i])
        print(f"{result.times[i] / 3600.0:8.3f}{'':18}{torques}")
    if plot is not None:
        from rx90_common.report.picture import write_picture

        write_picture(hours_plot(result), plot)
        print(one_line(f"plot: {plot}"))


def hours_plot(result: RepeatedLine) -> Plot:
    """Return temperatures, friction and path error over the hours."""
    from rx90_common.report.plot import COLOURS, Curve, Panel, Plot

    hours = result.times / 3600.0
    elements = list(zip(result.setup.friction.names, result.setup.friction.elements, COLOURS, strict=True))
    warmth = [
        Curve(hours, result.temperatures[:, i], name, colour)
        for i, (name, element, colour) in enumerate(elements)
        if element.temperature is not None
    ]
    share = result.friction / result.friction[0]
    friction = [Curve(hours, share[:, i], name, colour) for i, (name, _, colour) in enumerate(elements)]
    error = [
        Curve(hours, result.worst * 1e3, "worst", COLOURS[0]),
        Curve(hours, result.rms * 1e3, "RMS", COLOURS[1]),
    ]
    time = "time, h"
    return Plot(
        [
            Panel(warmth, "", time, "temperature of the joints, °C"),
            Panel(friction, "", time, "mean friction torque, over that at the start"),
            Panel(error, "", time, "path error, mm", from_zero=True),
        ],
        columns=3,
        height=3.6,
    )
