"""What `rx90_run` does, apart from its options: imported once these are understood, for it takes a second."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.application import with_parameters
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import SETTLING, run_line
from rx90_emulator.loop.result import RunResult, save_arrays, write_bag
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.trajectory_file import load_trajectory

Run = TypeVar("Run", bound=RunResult)


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
    rates = Rates(options.base_rate, options.position_rate)
    setup = Setup.load(RobotFiles.of_options(options), rates)
    if options.no_feed_forward:
        setup = with_parameters(setup, {"controller.feed_forward.*": False})
    for line in setup.friction.passivity_warnings(setup.robot.max_velocity.tolist()):
        print(f"rx90_run: warning: {line}", file=sys.stderr)
    result = _run_trajectory(setup, options) if options.trajectory else _run_line(setup, options)
    if result.saturated.any():
        print(f"motors at their limit, ticks: {result.saturated.tolist()}")
    if options.output is not None:
        write_bag(result, options.output, options.storage, options.decimation)
        print(f"bag: {options.output}")
    if options.arrays is not None:
        save_arrays(result, options.arrays)
        print(f"arrays: {options.arrays}")


def _run_line(setup: Setup, options: argparse.Namespace) -> RunResult:
    task = load_task(options.task)
    run = _timed(
        lambda: run_line(
            setup,
            task,
            start_time=options.start_time,
            substeps=options.substeps,
            record_fast=not options.slow_only,
        )
    )
    accuracy = run.path_accuracy
    print(f"path error: worst {accuracy.worst * 1e3:.4f} mm, RMS {accuracy.rms * 1e3:.4f} mm")
    return run


def _run_trajectory(setup: Setup, options: argparse.Namespace) -> RunResult:
    points = load_trajectory(options.trajectory, setup.robot.joint_names)
    run = _timed(
        lambda: simulate(
            setup,
            points,
            duration=options.start_time + float(points.times[-1]) + SETTLING,
            start_time=options.start_time,
            substeps=options.substeps,
            record_fast=not options.slow_only,
        )
    )
    error = np.abs(run.slow.tracking_error[:, 0]).max(axis=0)
    for name, worst in zip(setup.robot.joint_names, error, strict=True):
        print(f"{name}: worst tracking error {worst * 1e3:.4f} mrad")
    return run


def _timed(simulated: Callable[[], Run]) -> Run:
    began = time.perf_counter()
    run = simulated()
    elapsed = time.perf_counter() - began
    print(f"simulated {run.times[-1] + run.setup.rates.position_period:.3f} s in {elapsed:.2f} s")
    return run
