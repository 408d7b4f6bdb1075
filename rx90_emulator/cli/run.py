"""Run a line, a path or a trajectory in the closed loop without ROS, and write the bag that the nodes would."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, cast

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line
from rx90_emulator.cli.options import (
    FINITE,
    add_output,
    add_robot_arguments,
    add_slow_only,
    add_start_time,
    new_folder,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_emulator.loop.line import LineRun


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("motion", nargs="?", metavar="MOTION",
                        help="task file of a line, path file, or JointTrajectory in YAML, yours or a shipped one such "
                        "as paths/circle.yaml (the robot's task.yaml)")  # fmt: skip
    add_start_time(parser, "0")
    add_initial_position(parser, "of a trajectory its first point, of a line or path its start")
    add_run_arguments(parser)


def add_initial_position(parser: ArgumentParser, default: str) -> None:
    """Add the option of the joints' positions at time 0."""
    parser.add_argument("--initial-position", type=FINITE, nargs="+", metavar="RAD",
                        help=f"where each joint rests at time 0 ({default})")  # fmt: skip


def add_run_arguments(parser: ArgumentParser) -> None:
    """Add the options of a run: what is written, the controller's feed-forward, the seed, the robot."""
    parser.set_defaults(interrupted="only what is named above was written whole")
    add_output(parser, new_folder, "bag folder to write; must not exist", metavar="FOLDER")
    add_slow_only(parser)
    parser.add_argument("--feed-forward", choices=("all", "position", "none"), default="all",
                        help="position: dq_r off, D from the measured velocity alone, as the paper draws it; none: FF "
                        "off, too (%(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=whole_number, metavar="N",
                        help="of all that is random in the arm, such as the scatter of its friction; the same seed "
                        "gives the same bits (0, of a bag that of its run)")  # fmt: skip
    add_robot_arguments(parser)


def main(options: Namespace) -> None:
    """Run, show what came out, write what was asked for."""
    # Here, because --help must not wait for them.
    from rx90_common.base.share import resolve_config
    from rx90_controller.lines.task import SETTLING
    from rx90_emulator.loop.path_file import is_trajectory, load_motion

    setup = setup_of(options)
    start = options.initial_position
    check_count(start, setup)
    motion = None if options.motion is None else resolve_config(options.motion)
    if motion is not None and is_trajectory(motion):
        points = rx.load_trajectory(motion, setup.robot.joint_names)
        start = points.position[0] if start is None else start
        duration = options.start_time + float(points.times[-1]) + SETTLING
        finish(
            partial(rx.simulate, setup, points, start, duration, options.start_time),
            start,
            options,
        )
        return
    if start is not None:
        raise ConfigError(
            "--initial-position with a line or path, which begins at its start; accepted: a trajectory"
        )
    task = (
        rx.load_task(rx.RobotFiles.of_options(options).required("task"))
        if motion is None
        else load_motion(motion)
    )
    run = cast(
        "LineRun", _timed(partial(rx.run_path, setup, task, start_time=options.start_time), options)
    )
    _show_path(run, oriented=not isinstance(task, rx.LineTask))
    _write(run, options)


def setup_of(options: Namespace) -> rx.Setup:
    """Return the setup of the options, with the feed-forward that they leave on."""
    setup = rx.Setup.load(rx.RobotFiles.of_options(options), seed=options.seed or 0)
    if options.feed_forward == "none":
        setup = rx.with_parameters(setup, {"controller.feed_forward.*": False})
    if options.feed_forward == "position":
        setup = rx.with_parameters(setup, {"controller.feed_forward.velocity": False})
    return setup


def check_count(position: Sequence[float] | None, setup: rx.Setup) -> None:
    """Refuse a position with more or fewer numbers than the arm has joints."""
    joints = len(setup.robot.joint_names)
    if position is not None and len(position) != joints:
        given = counted(len(position), "number")
        raise ConfigError(f"--initial-position has {given}; accepted: {joints}, one for each joint")


def finish(
    simulate: Callable[..., rx.RunResult], start: Iterable[float], options: Namespace
) -> None:
    """Run a trajectory, show how well it was followed, write what was asked for."""
    print("begins at rest at", ", ".join(f"{angle:.6g}" for angle in start), "rad")
    result = _timed(simulate, options)
    slow = result.slow
    times = result.times
    print(
        rx.followed_accuracy(
            result.setup.robot, times, slow.joint_states[:, 0], times, slow.reference[:, 0]
        ).words
    )
    worst = abs(slow.tracking_error[:, 0]).max(axis=0)
    for name, error in zip(result.setup.robot.joint_names, worst, strict=True):
        print(f"{name}: worst tracking error {error * 1e3:.4f} mrad")
    _write(result, options)


def _timed(simulate: Callable[..., rx.RunResult], options: Namespace) -> rx.RunResult:
    began = time.perf_counter()
    result = simulate(record_fast=not options.slow_only)
    simulated = result.times[-1] + result.setup.rates.position_period
    print(f"simulated {simulated:.3f} s in {time.perf_counter() - began:.2f} s")
    return result


def _show_path(run: LineRun, *, oriented: bool) -> None:
    accuracy = run.path_accuracy
    for note in run.task.notes():
        print(note)
    print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
    if oriented:
        print(f"along the path: {accuracy.worst_along_track * 1e3:.4f} mm off the set-point; "
              f"orientation: {accuracy.worst_orientation * 1e3:.4f} mrad")  # fmt: skip


def _write(result: rx.RunResult, options: Namespace) -> None:
    if result.substeps > 1:
        print(f"plant steps in a tick: {result.substeps}")
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        rx.write_bag(result, options.output)
        print(one_line(f"bag: {options.output}"))
