"""Learn a correction of a path from trial to trial, and show what a correction file holds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rx90_common.base.errors import VERDICT_NO, check_replaced
from rx90_common.base.quoting import one_line
from rx90_emulator.cli.options import (
    POSITIVE,
    add_robot_arguments,
    add_verbs,
    check_picture,
    place,
    progress_bar,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_emulator.correction.file import CorrectionFile
    from rx90_emulator.correction.learning import TrialRecord
    from rx90_emulator.correction.methods import Filtered, NormOptimal
    from rx90_emulator.correction.path import CorrectablePath
    from rx90_emulator.loop.setup import Setup

_TIMEOUT = 30.0  # s
_METHODS = ("norm-optimal", "filtered")
_OPTIONS = ("effort", "joints", "cutoff", "gain", "lead")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    add_verbs(parser, _VERBS)


def main(options: argparse.Namespace) -> int | None:
    """Run the verb.

    Raises:
        Rx90Error: if it cannot be done.
    """
    code: int | None = options.run(options)
    return code


def _add_learn(learn: argparse.ArgumentParser) -> None:
    learn.set_defaults(interrupted="nothing was written")
    learn.add_argument("path", metavar="PATH", help="task file of a line, or a trajectory (YAML, as rx90_line --output "
                       "writes it)")  # fmt: skip
    learn.add_argument("--output", type=place, metavar="FILE", required=True, help="correction file to write, .yaml")
    learn.add_argument("--force", action="store_true", help="replace a correction file that exists")
    learn.add_argument("--trials", type=whole_number, metavar="N", help="after the first (4)")
    learn.add_argument("--previous", type=Path, metavar="FILE", help="correction file to go on from")
    method = learn.add_argument_group("method")
    method.add_argument("--method", choices=_METHODS, default=_METHODS[0], help="(%(default)s)")
    method.add_argument("--effort", type=POSITIVE, metavar="W", help="norm-optimal: weight of a change, m/rad (0.1)")
    method.add_argument("--joints", type=POSITIVE, metavar="W", help="norm-optimal: weight of the joints' own errors, "
                        "m/rad (0.005)")  # fmt: skip
    method.add_argument("--cutoff", type=POSITIVE, metavar="HZ", help="of the zero-phase filter, Hz (filtered: 40; "
                        "norm-optimal: none)")  # fmt: skip
    method.add_argument("--gain", type=POSITIVE, metavar="G", help="filtered: share of an error that is corrected (1)")
    method.add_argument("--lead", type=POSITIVE, metavar="S", help="filtered: s (1/kp)")
    method.add_argument("--noise", type=POSITIVE, metavar="M", help="by how much the path error may grow from trial to "
                        "trial, m (1e-6)")  # fmt: skip
    add_robot_arguments(learn)


def _learn(options: argparse.Namespace) -> int:
    """Learn a correction of a path, trial by trial, on the engine.

    The first trial is without correction, or with the one of --previous. Exit code 1: learning has failed, the path got
    worse trial after trial; the best correction is written.
    """
    check_replaced(options.output, force=options.force)
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.correction.file import load_correction, write_correction
    from rx90_emulator.correction.learning import NOISE, learn_correction, summary
    from rx90_emulator.loop.setup import Setup

    setup = Setup.load(RobotFiles.of_options(options))
    path, method = _path(options.path, setup), _method(options)
    earlier = None if options.previous is None else load_correction(options.previous)
    previous = None if earlier is None else earlier.fitting(setup, path)
    count = 4 if options.trials is None else options.trials
    with progress_bar("trials") as progress:
        done: list[TrialRecord] = []

        def told(trial: TrialRecord) -> None:
            done.append(trial)
            progress(len(done), count + 1)

        learned = learn_correction(
            setup, path, count, method, noise=options.noise or NOISE, previous=previous, told=told
        )
    print(summary(learned.trials))
    write_correction(learned, options.output, earlier)
    print(one_line(f"written to {options.output}: worst {learned.best.worst * 1e3:.4f} mm"))
    if learned.remark:
        print(one_line(f"learning has failed: {learned.remark}"))
        return VERDICT_NO
    return 0


def _path(name: str, setup: Setup) -> CorrectablePath:
    """Return the path of a file: a task of a line, or a trajectory."""
    from rx90_common.base.config import load_yaml
    from rx90_controller.lines.task import load_task
    from rx90_emulator.correction.path import TrajectoryPath
    from rx90_emulator.loop.line import plan_line
    from rx90_emulator.loop.trajectory_file import load_trajectory

    file = Path(name)
    if file.is_file() and "joint_names" in load_yaml(file, first=True):
        return TrajectoryPath.of(setup, load_trajectory(file, setup.robot.joint_names))
    return plan_line(setup, load_task(name))


def _method(options: argparse.Namespace) -> Filtered | NormOptimal:
    from rx90_emulator.correction.methods import method_named

    given: dict[str, Any] = {name: value for name in _OPTIONS if (value := getattr(options, name)) is not None}
    return method_named(options.method, **given)


def _add_show(show: argparse.ArgumentParser) -> None:
    show.add_argument("file", type=Path, metavar="FILE", help="correction file")
    show.add_argument("--plot", type=place, metavar="FILE", help="picture to write: trials, what is left, offsets "
                      "and spectra; .png, .svg or .pdf")  # fmt: skip
    show.set_defaults(interrupted="nothing was written")


def _show(options: argparse.Namespace) -> None:
    """Show what a correction file holds: for what it was learned, its trials, and its offsets."""
    if options.plot is not None:
        check_picture(options.plot)
    from rx90_emulator.correction.file import described, load_correction

    found = load_correction(options.file)
    print(described(found))
    if options.plot is not None:
        from rx90_common.report.picture import write_picture

        write_picture(_plot(found), options.plot)
        print(one_line(f"picture: {options.plot}"))


def _plot(found: CorrectionFile) -> Any:
    """Return trials, what is left along the path, offsets and spectra."""
    import numpy as np

    from rx90_common.report.plot import COLOURS, GREY, Curve, Panel, Plot
    from rx90_emulator.correction.file import spectrum

    period, offsets = found.correction.period, found.correction.offsets
    trials = np.arange(len(found.worst), dtype=np.float64)
    times = np.arange(found.distance.shape[1]) * period
    best = int(np.argmin(found.worst))
    shown = [(0, GREY, "first"), (best, COLOURS[0], "best")]
    left = [Curve(times, found.distance[k] * 1e3, name, colour) for k, colour, name in shown]
    spectra = [
        Curve(*(spectrum(found.distance[k] * 1e3, period)), f"error, {name}", colour) for k, colour, name in shown
    ]
    ticks = np.arange(len(offsets)) * period
    return Plot(
        (
            Panel([Curve(trials, np.array(found.worst) * 1e3, dots=True)], "trials", "trial", "worst path error, mm",
                  y_scale="log"),
            Panel(left, "what is left", "time on the path, s", "path error, mm", from_zero=True),
            Panel([Curve(ticks, offsets[:, k] * 1e3, f"joint {k + 1}", COLOURS[k]) for k in range(6)], "offsets",
                  "time from the trajectory's start, s", "mrad"),
            Panel(spectra, "spectra of the path error", "frequency, Hz", "mm", x_scale="log", y_scale="log"),
        )
    )  # fmt: skip


_VERBS = (
    (_add_learn, _learn, "learn a correction"),
    (_add_show, _show, "show what a correction file holds"),
)
