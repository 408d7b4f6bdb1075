"""What the parts of the control law and the paper's literal choices do, and the torque of the arm held at rest.

    python -m benchmarks.control_law

The numbers are exact: the closed loop gives the same bits on each run.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np

from benchmarks.report import merge, print_table
from rx90_common.base.arrays import Array
from rx90_common.description.robot_files import PAPER
from rx90_controller.lines.task import LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup, load_setup

# A ramp that is over within rounding of zero: the sign function as written.
_LITERAL_SIGN = 1e-12  # rad/s
_FF_BLOCK = {
    f"controller.feed_forward.{part}": False for part in ("acceleration", "coulomb", "viscous")
}
_PAPER_D = {"controller.feed_forward.velocity": False}
CASES: dict[str, tuple[str, dict[str, bool | float]]] = {
    "path_error_mm": ("as shipped", {}),
    "path_error_no_ff_mm": ("FF off", {**_FF_BLOCK}),
    "path_error_paper_d_mm": ("dq_r off", {**_PAPER_D}),
    "path_error_no_ff_paper_d_mm": ("FF and dq_r off", {**_FF_BLOCK, **_PAPER_D}),
}
_CONSTANT_C1 = {"friction.*.omega_d": math.inf}
# The most that a file accepts: the arm's own position and velocity, as nearly as the loop can have them.
_FINE_SENSORS = {"drives.encoder_counts": 2**30, "drives.velocity_bandwidth": 1999.0}
_SIGN = {"controller.coulomb_velocity": _LITERAL_SIGN}
CHOICES: dict[str, tuple[str, dict[str, bool | float]]] = {
    "paper_default": ("the default", {}),
    "paper_c1": ("constant c1", _CONSTANT_C1),
    "paper_sign": ("literal sign function", _SIGN),
    "paper_d": ("dq_r off", _PAPER_D),
    "paper_sensors": ("the default, sensors as fine as files may have them", _FINE_SENSORS),
}
"""What the default has otherwise than the paper, one by one; the row of them all is the setup PAPER."""
# There and back at 90 % of the joints' speeds; with dq_r off joint 1 lags by more than the shipped supervision allows.
_FAST, _FROM, _TO = 0.9, (-1.2, -0.6, 0.9, -1.2, -0.8, -1.2), (1.2, 0.6, 1.5, 1.2, 0.8, 1.2)  # rad
_WIDE = {"controller.following_error[*]": 1.0}
_POSE = (0.1, 0.5, 1.2, 0.2, 0.9, 0.3)  # rad, none of it on a count
_HELD, _LOOKED_AT = 4.0, 1.0  # s


def path_errors(setup: Setup, task: LineTask) -> dict[str, tuple[float, float]]:
    """Return worst and RMS path error of each case, m."""
    errors = {}
    for key, (_, changes) in CASES.items():
        path = run_line(with_parameters(setup, changes), task).path_accuracy
        errors[key] = path.worst, path.rms
    return errors


def fast_move(setup: Setup) -> RunResult:
    """Move all joints there and back, the one with the longest way at 90 % of its speed."""
    start, end = np.array(_FROM), np.array(_TO)
    way = float(np.max(np.abs(end - start) / (_FAST * setup.robot.max_velocity)))
    times = np.array([0.0, 1.0, 1.0 + way, 1.0 + 2.0 * way, 2.0 + 2.0 * way])
    points = TrajectoryPoints(times, np.array([start, start, end, start, start]), None, None)
    return simulate(setup, points, start, float(times[-1]))


def paper_choices(setup: Setup, task: LineTask) -> dict[str, tuple[str, Array]]:
    """Return of each choice its name and four figures, shape (4,).

    These are worst and RMS path error on the line, mm; in the fast move the largest position error of a joint, mrad,
    and the most that an element's friction torque differs from the default's at the same time, Nm.
    """
    setups = {
        key: (name, with_parameters(setup, changes)) for key, (name, changes) in CHOICES.items()
    }
    setups["paper_all"] = f"--paper: {PAPER}", replace(load_setup(robot=PAPER), rates=setup.rates)
    found, usual = {}, None
    for key, (name, one) in setups.items():
        path, fast = run_line(one, task).path_accuracy, fast_move(with_parameters(one, _WIDE)).slow
        torque = fast.friction_states[:, 2]
        usual = torque if usual is None else usual
        error = 1e3 * np.abs(fast.tracking_error[:, 0]).max()
        found[key] = (
            name,
            np.array([path.worst * 1e3, path.rms * 1e3, error, np.abs(torque - usual).max()]),
        )
    return found


def torque_at_rest(setup: Setup) -> tuple[float, float]:
    """Hold the arm; return the largest range and the largest step from tick to tick of a joint's torque, Nm."""
    pose = np.array(_POSE)
    points = TrajectoryPoints(np.array([0.0, _HELD]), np.array([pose, pose]), None, None)
    run = simulate(setup, points, record_fast=True)
    assert run.fast is not None
    torque = setup.drives.gear * run.fast.motor_commands[-round(_LOOKED_AT * setup.rates.base_hz) :]
    return float(np.ptp(torque, axis=0).max()), float(np.abs(np.diff(torque, axis=0)).max())


def main() -> int:
    """Run the cases, print the tables and merge the figures."""
    setup = Setup.load()
    errors = path_errors(setup, load_task())
    print_table(
        ("reference task, path error", "worst, mm", "RMS, mm"),
        [
            (CASES[key][0], f"{worst * 1e3:.3f}", f"{rms * 1e3:.3f}")
            for key, (worst, rms) in errors.items()
        ],
    )
    choices = paper_choices(setup, load_task())
    print_table(
        (
            "the paper's literal choices",
            "line, worst, mm",
            "RMS, mm",
            "fast move, error, mrad",
            "friction differs, Nm",
        ),
        [(name, *(f"{value:.4f}" for value in row)) for name, row in choices.values()],
    )
    extent, step = torque_at_rest(setup)
    print(
        f"held at rest: a joint's torque moves within {extent:.2f} Nm, by at most {step:.2f} Nm from tick to tick"
    )
    figures = {key: worst * 1e3 for key, (worst, _) in errors.items()}
    columns = ("worst_mm", "rms_mm", "fast_mrad", "friction_nm")
    figures |= {
        f"{key}_{of}": float(value)
        for key, (_, row) in choices.items()
        for of, value in zip(columns, row, strict=True)
    }
    merge(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
