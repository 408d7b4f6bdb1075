"""Run a line or a trajectory through the closed loop without ROS and write the bag that the nodes would."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line
from rx90_common.base.rates import Rates
from rx90_emulator.cli.options import (
    FINITE,
    add_robot_arguments,
    check_apart,
    check_needs,
    new_file,
    new_folder,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_emulator.loop.result import RunResult
    from rx90_emulator.loop.setup import Setup


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(interrupted="only what is named above was written whole")
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--task", metavar="FILE", help="task file (the robot's task.yaml)")
    motion.add_argument("--path", metavar="FILE", help="path file instead: lines, arcs, splines")
    motion.add_argument("--trajectory", type=Path, help="JointTrajectory in YAML instead of a task")
    motion.add_argument("--from-bag", type=Path, metavar="BAG",
                        help="the trajectories of a recorded bag, from where the arm began")  # fmt: skip
    parser.add_argument("--initial-position", type=FINITE, nargs="+", metavar="RAD",
                        help="where each joint rests at time 0 (of a trajectory its first point, of a bag the first "
                        "joint_states)")  # fmt: skip
    parser.add_argument("--start-time", type=FINITE, help="start of the task or trajectory, s (0)")
    parser.add_argument("--output", type=new_folder, help="bag folder to write; must not exist")
    parser.add_argument("--arrays", type=new_file, help="NumPy file to write (.npz), names with units; must not exist")
    parser.add_argument("--decimation", type=whole_number, help="write every n-th message of the 1 kHz topics (1)")
    parser.add_argument("--slow-only", action="store_true", help="leave the two 4 kHz topics out of bag and arrays")
    forward = parser.add_mutually_exclusive_group()
    forward.add_argument("--no-feed-forward", action="store_true",
                         help="FF and dq_r off: no feed-forward, and D from the measured velocity alone")  # fmt: skip
    forward.add_argument("--no-velocity-feed-forward", action="store_true",
                         help="dq_r off: D from the measured velocity alone, as the paper draws it")  # fmt: skip
    parser.add_argument("--seed", type=whole_number, metavar="N",
                        help="of all that is random in the arm, such as the scatter of its friction; the same seed "
                        "gives the same bits (0; with --from-bag that of the bag's run)")  # fmt: skip
    parser.add_argument("--base-rate", type=whole_number, default=4000, help="Hz (%(default)s)")
    parser.add_argument("--position-rate", type=whole_number, default=1000, help="Hz (%(default)s)")
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Simulate and write what was asked for."""
    _check(options)
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.loop.parameters import with_parameters
    from rx90_emulator.loop.result import save_arrays, write_bag
    from rx90_emulator.loop.setup import Setup

    rates = Rates(options.base_rate, options.position_rate)
    setup = Setup.load(RobotFiles.of_options(options), rates, options.seed or 0)
    if options.no_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.*": False})
    if options.no_velocity_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.velocity": False})
    result = _simulate(setup, options)
    if result.substeps > 1:
        print(f"plant steps in a tick: {result.substeps}")
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        write_bag(result, options.output, options.decimation or 1)
        print(one_line(f"bag: {options.output}"))
    if options.arrays is not None:
        save_arrays(result, options.arrays)
        print(one_line(f"arrays: {options.arrays}"))


def _check(options: argparse.Namespace) -> None:
    """Refuse what can be seen to be wrong before anything is read."""
    if options.decimation is not None and options.decimation < 1:
        raise ConfigError(f"--decimation is {options.decimation}; accepted: a whole number >= 1")
    check_needs(options, ("decimation",), ("output",))
    check_needs(options, ("slow_only",), ("output", "arrays"))
    check_apart(options, ("start_time",), "from_bag", "the times in the bag")
    check_needs(options, ("initial_position",), ("trajectory", "from_bag"))


def _simulate(setup: Setup, options: argparse.Namespace) -> RunResult:
    """Run what was asked for; print where the arm begins and how well it kept to its path."""
    from rx90_common.description.robot_files import RobotFiles
    from rx90_controller.lines.task import SETTLING, load_task
    from rx90_emulator.loop import closed_loop
    from rx90_emulator.loop.line import LineRun, followed_accuracy, run_path
    from rx90_emulator.loop.path_file import load_path, load_trajectory
    from rx90_emulator.loop.recorded_run import read_run, replay

    begin = options.start_time or 0.0
    start = options.initial_position
    _check_count(start, len(setup.robot.joint_names))
    simulate: Callable[..., RunResult]
    if options.from_bag is not None:
        recorded = read_run(options.from_bag, setup, start)
        starts = ", ".join(f"{command.start * setup.rates.position_period:.3f} s" for command in recorded.commands)
        print(f"trajectories in {one_line(options.from_bag)}: {len(recorded.commands)}, from {starts}")
        if options.seed is None:
            print("seed 0: the bag tells none" if recorded.seed is None else f"seed {recorded.seed}, as the bag tells")
        else:
            if recorded.seed not in (None, options.seed):
                _warn(f"the seed of that run was {recorded.seed}; here --seed {options.seed} holds")
            recorded = replace(recorded, seed=options.seed)
        if recorded.changed:
            _warn(f"{', '.join(recorded.changed)} changed in that run; here the controller file holds throughout")
        if recorded.given:
            _warn(
                f"{', '.join(recorded.given)} had other values in that run from its beginning; here the controller "
                "file and the options of this command hold"
            )
        start = recorded.initial_position
        simulate = partial(replay, setup, recorded)
    elif options.trajectory is not None:
        points = load_trajectory(options.trajectory, setup.robot.joint_names)
        start = points.position[0] if start is None else start
        simulate = partial(
            closed_loop.simulate, setup, points, start, begin + float(points.times[-1]) + SETTLING, begin
        )
    else:
        task = load_path(options.path) if options.path else load_task(RobotFiles.of_options(options).required("task"))
        simulate = partial(run_path, setup, task, start_time=begin)
    if start is not None:
        print("begins at rest at", ", ".join(f"{angle:.6g}" for angle in start), "rad")
    began = time.perf_counter()
    result: RunResult = simulate(record_fast=not options.slow_only)
    simulated = result.times[-1] + result.setup.rates.position_period
    print(f"simulated {simulated:.3f} s in {time.perf_counter() - began:.2f} s")
    if isinstance(result, LineRun):
        accuracy = result.path_accuracy
        print("\n".join(result.task.notes()), end="\n" * bool(result.task.notes()))
        print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
        if options.path is not None:
            print(f"along the path: {accuracy.worst_along_track * 1e3:.4f} mm off the set-point; "
                  f"orientation: {accuracy.worst_orientation * 1e3:.4f} mrad")  # fmt: skip
        return result
    slow = result.slow
    times = result.times
    print(followed_accuracy(setup.robot, times, slow.joint_states[:, 0], times, slow.reference[:, 0]).words)
    worst = abs(slow.tracking_error[:, 0]).max(axis=0)
    for name, error in zip(setup.robot.joint_names, worst, strict=True):
        print(f"{name}: worst tracking error {error * 1e3:.4f} mrad")
    return result


def _check_count(position: Sequence[float] | None, joints: int) -> None:
    if position is not None and len(position) != joints:
        given = counted(len(position), "number")
        raise ConfigError(f"--initial-position has {given}; accepted: {joints}, one for each joint")


def _warn(text: str) -> None:
    print(f"rx90_run: warning: {text}", file=sys.stderr)
