"""Learn a correction of a path from trial to trial, and show what a correction file holds."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rx90_emulator as rx
from rx90_common.base.errors import DONE, VERDICT_NO, check_replaced
from rx90_common.base.quoting import counted, one_line, plain
from rx90_emulator.cli.options import (
    POSITIVE,
    add_force,
    add_node_arguments,
    add_output,
    add_robot_arguments,
    place,
    progress_bar,
    setup_of,
    whole_number,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from rx90_emulator.correction.file import CorrectionFile
    from rx90_emulator.correction.learning import LearnedCorrection, Measured
    from rx90_emulator.correction.path import CorrectablePath


def _add_engine(parser: ArgumentParser) -> None:
    _add_learning(parser)
    _add_trials(parser)
    parser.add_argument("--true-tip", action="store_true", help="learn from the simulated arm's tip, not from its "
                        "encoders, which do not see what gears do")  # fmt: skip
    add_robot_arguments(parser)


def _add_nodes(parser: ArgumentParser) -> None:
    _add_learning(parser)
    _add_trials(parser)
    add_node_arguments(parser)
    add_robot_arguments(parser)


def _add_recorded(parser: ArgumentParser) -> None:
    _add_learning(parser)
    parser.add_argument(
        "--bag",
        type=Path,
        metavar="BAG",
        help="of the joints, from an arm or the nodes, or a table",
    )
    parser.add_argument(
        "--topic", default="joint_states", metavar="TOPIC", help="of the joints in it (%(default)s)"
    )
    parser.add_argument("--tip", type=Path, metavar="FILE", help="the tip, measured in that trial: time [s], x [m], "
                        "y [m], z [m] in the base frame")  # fmt: skip
    add_robot_arguments(parser)


def _add_learning(parser: ArgumentParser) -> None:
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("path", metavar="PATH", help="path file, task file of a line, or a trajectory (YAML, as "
                        "rx90 line --output writes it)")  # fmt: skip
    add_output(parser, place, "correction file to write, .yaml", metavar="FILE", required=True)
    add_force(parser)
    parser.add_argument(
        "--previous", type=Path, metavar="FILE", help="correction file to go on from"
    )
    method = parser.add_argument_group("norm-optimal learning")
    method.add_argument(
        "--effort",
        type=POSITIVE,
        metavar="W",
        default=0.1,
        help="weight of a change, m/rad (%(default)s)",
    )
    method.add_argument("--noise", type=POSITIVE, metavar="M", default=1e-6,
                        help="by how much the path error may grow from trial to trial, m (%(default)s)")  # fmt: skip


def _add_trials(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--trials", type=whole_number, metavar="N", default=4, help="after the first (%(default)s)"
    )


def _engine(options: Namespace) -> int:
    """Learn a correction of a path, trial by trial, in the closed loop without ROS.

    The first trial is without correction, or with the one of --previous. Exit code 1: the path got worse, trial after
    trial; the best correction is written.
    """
    from rx90_emulator.correction.learning import ENGINE, run_corrected

    learner, earlier = _learner(options, tip=options.true_tip)

    def play(played: Any) -> Any:
        return run_corrected(learner.setup, learner.nominal, played)[1]

    return _end(options, _learned(options, learner, play, ENGINE), earlier)


def _nodes(options: Namespace) -> int:
    """Learn a correction of a path, trial by trial, on the running nodes; each trial is recorded.

    The first trial is without correction, or with the one of --previous. Exit code 1: the path got worse, trial after
    trial; the best correction is written.
    """
    from rx90_emulator.correction.learning import NODES

    learner, earlier = _learner(options, tip=False)
    from rx90_common.exchange.ros_start import prepare

    prepare()
    from rx90_emulator.correction.nodes import node_trials

    with node_trials(learner, options.node, options.timeout) as play:
        learned = _learned(options, learner, play, NODES)
    return _end(options, learned, earlier)


def _recorded(options: Namespace) -> int:
    """Learn from one recorded trial, played with the correction of --previous or without one.

    What is written is for the next trial. Exit code 1: the path got worse with the trial that was recorded; half the
    step is written.
    """
    from rx90_emulator.correction.learning import CorrectionError

    if options.bag is None and options.tip is None:
        raise CorrectionError(
            "no --bag and no --tip; accepted: one of them, or both of the same trial"
        )
    learner, earlier = _learner(options, tip=options.tip is not None)
    found, lines = rx.measured(
        learner.setup, learner.nominal, options.bag, options.tip, options.topic
    )
    print("\n".join(one_line(line) for line in lines))
    try:
        learned, why = rx.learn_from_record(learner, found, earlier)
    except CorrectionError as error:
        print(one_line(f"learning has failed, nothing written: {error}"))
        return VERDICT_NO
    said = "for the next trial: half the step from the best trial" if why else "for the next trial"
    return _end(options, learned, earlier, said, why)


def _learner(options: Namespace, *, tip: bool) -> tuple[rx.Learner, CorrectionFile | None]:
    """Return what learns the path of the options, and the correction file that it goes on from."""
    from rx90_emulator.correction.file import correction_files

    for file in correction_files(options.output):
        check_replaced(file, force=options.force)
    setup = setup_of(options)
    path = _path(options.path, setup)
    method = rx.NormOptimal(options.effort)
    earlier = None if options.previous is None else rx.load_correction(options.previous)
    previous = None if earlier is None else earlier.fitting(setup, path).offsets
    return rx.Learner(setup, path, method, tip=tip, noise=options.noise, previous=previous), earlier


def _learned(
    options: Namespace, learner: rx.Learner, play: Callable[..., Measured], where: str
) -> LearnedCorrection:
    """Play the trials."""
    from rx90_emulator.correction.learning import learn

    count = options.trials + 1
    with progress_bar("trials") as progress:
        return learn(
            learner, play, options.trials, where, lambda: progress(len(learner.trials), count)
        )


def _end(
    options: Namespace,
    learned: LearnedCorrection,
    earlier: CorrectionFile | None,
    said: str = "",
    why: str = "",
) -> int:
    """Show the trials, and write the correction."""
    from rx90_emulator.correction.learning import summary

    print(summary(learned.trials))
    rx.write_correction(learned, options.output, earlier)
    said = said or f"worst {learned.best.worst * 1e3:.4f} mm"
    print(one_line(f"written to {options.output}: {said}"))
    if learned.remark:
        why = f"learning has failed: {learned.remark}"
    if why:
        print(one_line(why))
        return VERDICT_NO
    return DONE


def _path(name: str, setup: rx.Setup) -> CorrectablePath:
    """Return the path of a file: a path file, a task of a line, or a trajectory."""
    from rx90_emulator.loop.path_file import is_trajectory, load_motion

    file = Path(name)
    if file.is_file() and is_trajectory(file):
        return rx.TrajectoryPath.of(setup, rx.load_trajectory(file, setup.robot.joint_names))
    return rx.plan_path(setup, load_motion(name))


def _add_show(show: ArgumentParser) -> None:
    show.add_argument("file", type=Path, metavar="FILE", help="correction file")


def _show(options: Namespace) -> None:
    """Show what a correction file holds: for what it was learned, its trials, and its offsets."""
    import numpy as np

    found = rx.load_correction(options.file)
    head = found.head
    offsets = found.correction.offsets
    period = found.correction.period
    print(f"robot {plain(head.robot)}, {head.payload.mass:.4g} kg on the last joint")
    print(f"path of {head.path.duration:.3f} s, up to {head.path.speed * 1e3:.4g} mm/s")
    print(f"learned by {plain(head.method)}")
    for number, (how, worst) in enumerate(zip(head.seen, head.worst, strict=True)):
        print(f"trial {number}, {how}: worst {worst * 1e3:.4f} mm")
    rate = float(np.abs(np.diff(offsets, axis=0)).max(initial=0.0)) / period
    print(f"largest offset {float(np.abs(offsets).max()):.3g} rad, fastest change {rate:.3g} rad/s")


def _add_precompensate(precompensate: ArgumentParser) -> None:
    precompensate.add_argument("file", type=Path, metavar="FILE", help="correction file")
    precompensate.add_argument(
        "path", metavar="PATH", help="task, path or trajectory that it is of"
    )
    about = "trajectory to write: .yaml, or .csv for its set-points: s, joints in deg, tool in mm and deg"
    add_output(precompensate, place, about, metavar="FILE", required=True)
    add_force(precompensate)
    precompensate.add_argument("--cutoff", type=POSITIVE, metavar="HZ", default=5.0,
                               help="of the filter that smooths the offsets (%(default)s)")  # fmt: skip
    add_robot_arguments(precompensate)
    precompensate.set_defaults(interrupted="nothing was written")


def _precompensate(options: Namespace) -> None:
    """Write the corrected path as a trajectory, for a controller without a channel, and say what is lost.

    The path errors are those of the engine, with the arm of the files.
    """
    check_replaced(options.output, force=options.force)
    from rx90_emulator.correction.precompensation import corrected_trajectory, travelled_error
    from rx90_emulator.loop.trajectory_file import write_trajectory

    setup = setup_of(options)
    path = _path(options.path, setup)
    cutoff = options.cutoff
    found = rx.load_correction(options.file)
    points = corrected_trajectory(setup, path, found.fitting(setup, path), cutoff)
    before = travelled_error(setup, path, path.points)
    after = travelled_error(setup, path, points)
    write_trajectory(options.output, setup.robot, points, 1.0 / setup.rates.position_hz)
    print(one_line(f"written to {options.output}: {counted(len(points.times), 'point')}"))
    smoothed = (
        f"{after * 1e3:.4f} mm with the offsets below {cutoff:g} Hz, {before * 1e3:.4f} mm without"
    )
    learned = f"{min(found.head.worst) * 1e3:.4f} mm"
    print(
        f"worst path error on the engine: {smoothed}; all offsets, when they were learned: {learned}"
    )


SUBCOMMANDS = (
    (_add_engine, _engine, "learn a correction from trials in the closed loop without ROS"),
    (_add_nodes, _nodes, "learn it from trials on the running nodes"),
    (_add_recorded, _recorded, "learn from one recorded trial of an arm"),
    (_add_show, _show, "show what a correction file holds"),
    (_add_precompensate, _precompensate, "write the corrected path as a trajectory"),
)
