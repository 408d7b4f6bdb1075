"""Run a line or a trajectory through the closed loop without ROS and write the bag that the nodes would."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import one_line
from rx90_common.base.rates import Rates
from rx90_emulator.cli.options import (
    FINITE,
    STORAGE,
    add_robot_arguments,
    check_needs,
    new_file,
    new_folder,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_emulator.loop.recorded_run import RecordedRun
    from rx90_emulator.loop.result import RunResult
    from rx90_emulator.loop.setup import Setup

Run = TypeVar("Run", bound="RunResult")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(interrupted="only what is named above was written whole")
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--task", metavar="FILE", help="task file (the robot's task.yaml)")
    motion.add_argument("--trajectory", type=Path, help="JointTrajectory in YAML instead of a task")
    motion.add_argument(
        "--from-bag",
        type=Path,
        metavar="BAG",
        help="the trajectories of a recorded bag, from where the arm began",
    )
    parser.add_argument(
        "--initial-position", type=FINITE, nargs=6, metavar="RAD",
        help="where the arm rests at time 0 (of a trajectory its first point, of a bag the first joint_states)",
    )  # fmt: skip
    parser.add_argument("--start-time", type=FINITE, help="start of the task or trajectory, s (0)")
    parser.add_argument(
        "--hours", type=FINITE, metavar="H",
        help="run the task there and back for so long, as the joints get warm: friction and path error over a working "
        "day; for friction with temperature",
    )  # fmt: skip
    parser.add_argument("--plot", type=new_file, metavar="FILE", help="picture of it (.png, .svg); must not exist")
    parser.add_argument("--output", type=new_folder, help="bag folder to write; must not exist")
    parser.add_argument("--arrays", type=new_file, help="NumPy file to write (.npz), names with units; must not exist")
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), help=f"of the bag ({STORAGE})")
    parser.add_argument("--decimation", type=whole_number, help="write every n-th message of the 1 kHz topics (1)")
    parser.add_argument("--slow-only", action="store_true", help="leave the two 4 kHz topics out of bag and arrays")
    forward = parser.add_mutually_exclusive_group()
    forward.add_argument(
        "--no-feed-forward",
        action="store_true",
        help="FF and dq_r off: no feed-forward, and D from the measured velocity alone",
    )
    forward.add_argument(
        "--no-velocity-feed-forward",
        action="store_true",
        help="dq_r off: D from the measured velocity alone, as the paper draws it",
    )
    parser.add_argument("--substeps", type=whole_number, help="plant steps in a tick (as many as the arm needs)")
    parser.add_argument(
        "--seed", type=whole_number, metavar="N",
        help="of all that is random in the arm, such as the scatter of its friction; the same seed gives the same bits "
        "(0; with --from-bag that of the bag's run)",
    )  # fmt: skip
    parser.add_argument("--base-rate", type=whole_number, default=4000, help="Hz (%(default)s)")
    parser.add_argument("--position-rate", type=whole_number, default=1000, help="Hz (%(default)s)")
    parser.add_argument(
        "--temperature-rate", type=whole_number, metavar="HZ",
        help="of temperatures in bag and arrays, Hz (1; with --from-bag that of the bag's run)",
    )  # fmt: skip
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Simulate and write what was asked for.

    Raises:
        Rx90Error: for what cannot be done, before anything has been written.
    """
    _check(options)
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.cli.run_hours import run_hours
    from rx90_emulator.loop.parameters import with_parameters
    from rx90_emulator.loop.result import save_arrays, write_bag
    from rx90_emulator.loop.setup import Setup

    of_temperatures = Rates.temperature_hz if options.temperature_rate is None else options.temperature_rate
    rates = Rates(options.base_rate, options.position_rate, of_temperatures)
    setup = Setup.load(RobotFiles.of_options(options), rates, options.seed or 0)
    if options.no_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.*": False})
    if options.no_velocity_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.velocity": False})
    if options.hours is not None:
        run_hours(setup, options)
        return
    result = _simulate(setup, options)
    if result.substeps > 1:
        print(f"plant steps in a tick: {result.substeps}")
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        write_bag(result, options.output, options.storage or STORAGE, options.decimation or 1)
        print(one_line(f"bag: {options.output}"))
    if options.arrays is not None:
        save_arrays(result, options.arrays)
        print(one_line(f"arrays: {options.arrays}"))


def _check(options: argparse.Namespace) -> None:
    """Refuse what can be seen to be wrong before anything is read.

    Raises:
        ConfigError: naming the option.
    """
    from rx90_emulator.cli.run_hours import check_hours

    check_hours(options)
    if options.decimation is not None and options.decimation < 1:
        raise ConfigError(f"--decimation is {options.decimation}; accepted: a whole number >= 1")
    check_needs(options, ("storage", "decimation"), ("output",))
    check_needs(options, ("slow_only", "temperature_rate"), ("output", "arrays"))
    if options.from_bag is not None and options.start_time is not None:
        raise ConfigError("--start-time with --from-bag; accepted: the times in the bag")
    if options.from_bag is not None and options.temperature_rate is not None:
        raise ConfigError("--temperature-rate with --from-bag; accepted: the rate in the bag")
    if options.initial_position is not None and options.trajectory is None and options.from_bag is None:
        raise ConfigError("--initial-position with a task; accepted: with --trajectory or --from-bag")


def _simulate(setup: Setup, options: argparse.Namespace) -> RunResult:
    """Run what was asked for, and print how well the arm kept to it."""
    from rx90_common.description.robot_files import RobotFiles
    from rx90_controller.lines.task import load_task
    from rx90_emulator.loop.line import run_line

    how = {"substeps": options.substeps, "record_fast": not options.slow_only}
    begin = options.start_time or 0.0
    if options.trajectory is None and options.from_bag is None:
        task = load_task(RobotFiles.of_options(options).required("task"))
        line = _timed(lambda: run_line(setup, task, start_time=begin, **how))
        accuracy = line.path_accuracy
        print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
        return line
    run = _timed(_trajectory_run(setup, options, begin, how))
    for name, worst in zip(setup.robot.joint_names, abs(run.slow.tracking_error[:, 0]).max(axis=0), strict=True):
        print(f"{name}: worst tracking error {worst * 1e3:.4f} mrad")
    return run


def _trajectory_run(
    setup: Setup, options: argparse.Namespace, begin: float, how: dict[str, Any]
) -> Callable[[], RunResult]:
    """Read the trajectory or bag, say where the arm begins, and return what runs it."""
    from rx90_controller.lines.task import SETTLING
    from rx90_emulator.loop.closed_loop import simulate
    from rx90_emulator.loop.recorded_run import read_run, replay
    from rx90_emulator.loop.trajectory_file import load_trajectory

    start = options.initial_position
    if options.from_bag is not None:
        recorded = read_run(options.from_bag, setup, start)
        start = recorded.initial_position
        told = ", ".join(f"{command.start * setup.rates.position_period:.3f} s" for command in recorded.commands)
        print(f"trajectories in {one_line(options.from_bag)}: {len(recorded.commands)}, from {told}")
        recorded = _with_seed(recorded, options)
        if recorded.changed:
            names = ", ".join(recorded.changed)
            print(
                f"rx90_run: warning: {names} changed in that run; here the controller file holds throughout",
                file=sys.stderr,
            )
        run: Callable[[], RunResult] = partial(replay, setup, recorded, **how)
        if recorded.given:
            names = ", ".join(recorded.given)
            print(
                f"rx90_run: warning: {names} had other values in that run from its beginning; here the controller file "
                "and the options of this command hold",
                file=sys.stderr,
            )
    else:
        points = load_trajectory(options.trajectory, setup.robot.joint_names)
        start = points.position[0] if start is None else start
        duration = begin + float(points.times[-1]) + SETTLING
        run = partial(simulate, setup, points, start, duration, begin, **how)
    print("begins at rest at", ", ".join(f"{angle:.6g}" for angle in start), "rad")
    return run


def _with_seed(recorded: RecordedRun, options: argparse.Namespace) -> RecordedRun:
    """Return the run with the seed to take, which is that of the bag unless another one is asked for; say which."""
    told = recorded.seed
    if options.seed is not None:
        if told not in (None, options.seed):
            print(
                f"rx90_run: warning: the seed of that run was {told}; here --seed {options.seed} holds", file=sys.stderr
            )
        return replace(recorded, seed=options.seed)
    print("seed 0: the bag tells none" if told is None else f"seed {told}, as the bag tells")
    return recorded


def _timed(simulated: Callable[[], Run]) -> Run:
    began = time.perf_counter()
    run = simulated()
    elapsed = time.perf_counter() - began
    print(f"simulated {run.times[-1] + run.setup.rates.position_period:.3f} s in {elapsed:.2f} s")
    return run
