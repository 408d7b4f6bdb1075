"""Run a line or a trajectory through the closed loop without ROS and write the bag that the nodes would."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rx90_common.base.errors import ConfigError, check_place
from rx90_common.base.rates import Rates
from rx90_common.base.share import REFERENCE_TASK
from rx90_emulator.cli.options import add_robot_arguments

if TYPE_CHECKING:
    from rx90_emulator.loop.result import RunResult
    from rx90_emulator.loop.setup import Setup

Run = TypeVar("Run", bound="RunResult")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(interrupted="nothing was written")
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--task", default=REFERENCE_TASK, help="task file (%(default)s)")
    motion.add_argument(
        "--trajectory", type=Path, help="JointTrajectory in YAML, begun at rest in its first point, instead of a task"
    )
    parser.add_argument("--start-time", type=float, default=0.0, help="start of the trajectory, s (%(default)s)")
    parser.add_argument("--output", type=Path, help="bag folder to write; must not exist")
    parser.add_argument("--arrays", type=Path, help="NumPy file to write (.npz), names with units; must not exist")
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="of the bag (%(default)s)")
    parser.add_argument(
        "--decimation", type=int, default=1, help="write every n-th message of the 1 kHz topics (%(default)s)"
    )
    parser.add_argument("--slow-only", action="store_true", help="leave the two 4 kHz topics out of the bag")
    forward = parser.add_mutually_exclusive_group()
    forward.add_argument(
        "--no-feed-forward",
        action="store_true",
        help="switch all feed-forward off, the velocity set-point in D included",
    )
    forward.add_argument(
        "--no-velocity-feed-forward",
        action="store_true",
        help="D from the measured velocity alone, as the paper draws it",
    )
    parser.add_argument("--substeps", type=int, default=1, help="plant steps in a tick (%(default)s)")
    parser.add_argument("--base-rate", type=int, default=4000, help="Hz (%(default)s)")
    parser.add_argument("--position-rate", type=int, default=1000, help="Hz (%(default)s)")
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Simulate and write what was asked for.

    Raises:
        Rx90Error: for what cannot be done, before anything has been written.
    """
    if options.decimation < 1:
        raise ConfigError(f"--decimation is {options.decimation}; accepted: a whole number >= 1")
    if options.output is not None and options.output.exists():
        raise ConfigError(f"--output is {options.output}, which exists; accepted: a new folder")
    if options.arrays is not None and options.arrays.exists():
        raise ConfigError(f"--arrays is {options.arrays}, which exists; accepted: a new file")
    for path in (options.output, options.arrays):
        if path is not None:
            check_place(path)
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.loop.application import with_parameters
    from rx90_emulator.loop.result import save_arrays, write_bag
    from rx90_emulator.loop.setup import Setup

    setup = Setup.load(RobotFiles.of_options(options), Rates(options.base_rate, options.position_rate))
    if options.no_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.*": False})
    if options.no_velocity_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.velocity": False})
    for line in setup.friction.passivity_warnings(setup.robot.max_velocity.tolist()):
        print(f"rx90_run: warning: {line}", file=sys.stderr)
    result = _simulate(setup, options)
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        write_bag(result, options.output, options.storage, options.decimation)
        print(f"bag: {options.output}")
    if options.arrays is not None:
        save_arrays(result, options.arrays)
        print(f"arrays: {options.arrays}")


def _simulate(setup: Setup, options: argparse.Namespace) -> RunResult:
    """Run what was asked for, and print how well the arm kept to it."""
    from rx90_controller.lines.task import load_task
    from rx90_emulator.loop.closed_loop import simulate
    from rx90_emulator.loop.line import SETTLING, run_line
    from rx90_emulator.loop.trajectory_file import load_trajectory

    how = {"start_time": options.start_time, "substeps": options.substeps, "record_fast": not options.slow_only}
    if options.trajectory is None:
        task = load_task(options.task)
        line = _timed(lambda: run_line(setup, task, **how))
        accuracy = line.path_accuracy
        print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
        return line
    points = load_trajectory(options.trajectory, setup.robot.joint_names)
    duration = options.start_time + float(points.times[-1]) + SETTLING
    run = _timed(lambda: simulate(setup, points, duration=duration, **how))
    for name, worst in zip(setup.robot.joint_names, abs(run.slow.tracking_error[:, 0]).max(axis=0), strict=True):
        print(f"{name}: worst tracking error {worst * 1e3:.4f} mrad")
    return run


def _timed(simulated: Callable[[], Run]) -> Run:
    began = time.perf_counter()
    run = simulated()
    elapsed = time.perf_counter() - began
    print(f"simulated {run.times[-1] + run.setup.rates.position_period:.3f} s in {elapsed:.2f} s")
    return run
