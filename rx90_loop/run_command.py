"""`rx90_run`: run a line or a trajectory through the closed loop without ROS and write the bag that the nodes would."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rx90_common.compiled import announce_compilation
from rx90_common.errors import ConfigError, Rx90Error
from rx90_common.rates import Rates
from rx90_common.share import resolve_config
from rx90_controller.cs7b_parameters import FeedForward
from rx90_controller.line_task import load_task
from rx90_loop.arrays import save_arrays
from rx90_loop.closed_loop import RunResult, simulate
from rx90_loop.run_bag import write_run
from rx90_loop.setup import Setup, SetupFiles
from rx90_loop.task_run import SETTLING, path_accuracy, run_task
from rx90_loop.trajectory_file import load_trajectory


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    options = _parser().parse_args(args)
    try:
        _run(options)
    except Rx90Error as error:
        print(f"rx90_run: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("rx90_run: stopped; nothing was written", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="rx90_run", description=__doc__)
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--task", default="task/reference_line.yaml", help="task file (%(default)s)")
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
    parser.add_argument("--urdf", help="robot (shipped RX90B)")
    parser.add_argument("--tool", help="tool file (shipped laser head)")
    parser.add_argument("--drives", help="drives file")
    parser.add_argument("--friction", help="friction file")
    parser.add_argument("--controller", help="controller file")
    parser.add_argument("--no-feed-forward", action="store_true", help="switch the feed-forward block off")
    parser.add_argument("--substeps", type=int, default=1, help="plant steps in a tick (%(default)s)")
    parser.add_argument("--base-rate", type=int, default=4000, help="Hz (%(default)s)")
    parser.add_argument("--position-rate", type=int, default=1000, help="Hz (%(default)s)")
    return parser


def _run(options: argparse.Namespace) -> None:
    if options.decimation < 1:
        raise ConfigError(f"--decimation is {options.decimation}; accepted: a whole number >= 1")
    if options.output is not None and options.output.exists():
        raise ConfigError(f"--output is {options.output}, which exists; accepted: a new folder")
    if options.arrays is not None and options.arrays.exists():
        raise ConfigError(f"--arrays is {options.arrays}, which exists; accepted: a new file")
    files = {
        key: resolve_config(getattr(options, key))
        for key in ("urdf", "tool", "drives", "friction", "controller")
        if getattr(options, key) is not None
    }
    setup = Setup.load(SetupFiles(**files), Rates(options.base_rate, options.position_rate))
    if options.no_feed_forward:
        controller = dataclasses.replace(setup.controller, feed_forward=FeedForward.off())
        setup = dataclasses.replace(setup, controller=controller)
    for line in setup.friction.passivity_warnings(setup.robot.max_velocity.tolist()):
        print(f"rx90_run: warning: {line}", file=sys.stderr)
    result = _run_trajectory(setup, options) if options.trajectory else _run_line(setup, options)
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        write_run(result, options.output, options.storage, options.decimation)
        print(f"bag: {options.output}")
    if options.arrays is not None:
        save_arrays(result, options.arrays)
        print(f"arrays: {options.arrays}")


def _run_line(setup: Setup, options: argparse.Namespace) -> RunResult:
    task = load_task(resolve_config(options.task))
    result = _timed(
        lambda: run_task(
            setup,
            task,
            start_time=options.start_time,
            substeps=options.substeps,
            record_fast=not options.slow_only,
        )
    )
    accuracy = path_accuracy(setup.robot, task, result.times, result.slow.joint_states[:, 0], options.start_time)
    print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
    return result


def _run_trajectory(setup: Setup, options: argparse.Namespace) -> RunResult:
    points = load_trajectory(options.trajectory, setup.robot.joint_names)
    result = _timed(
        lambda: simulate(
            setup,
            points,
            points.position[0],
            options.start_time + float(points.times[-1]) + SETTLING,
            start_time=options.start_time,
            substeps=options.substeps,
            record_fast=not options.slow_only,
        )
    )
    error = np.abs(result.slow.tracking_error[:, 0]).max(axis=0)
    for name, worst in zip(setup.robot.joint_names, error, strict=True):
        print(f"{name}: worst tracking error {worst * 1e3:.4f} mrad")
    return result


def _timed(run: Callable[[], RunResult]) -> RunResult:
    announce_compilation("rx90_run")
    began = time.perf_counter()
    result = run()
    elapsed = time.perf_counter() - began
    print(f"simulated {result.times[-1] + result.setup.rates.position_period:.3f} s in {elapsed:.2f} s")
    return result


if __name__ == "__main__":
    sys.exit(main())
