"""What `rx90_run` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable

import numpy as np

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import SHIPPED, RobotFiles
from rx90_controller.law.parameters import FeedForward
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.closed_loop import RunResult, simulate
from rx90_emulator.loop.result import save_arrays
from rx90_emulator.loop.run_bag import write_run
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.task_run import SETTLING, path_accuracy, run_task
from rx90_emulator.loop.trajectory_file import load_trajectory


def run(options: argparse.Namespace) -> None:
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
    files = RobotFiles.named(**{key: getattr(options, key) for key in SHIPPED})
    setup = Setup.load(files, Rates(options.base_rate, options.position_rate))
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
    began = time.perf_counter()
    result = run()
    elapsed = time.perf_counter() - began
    print(f"simulated {result.times[-1] + result.setup.rates.position_period:.3f} s in {elapsed:.2f} s")
    return result
