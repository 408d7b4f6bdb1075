"""What the parts of the control law do: path error of the reference task, and torque of the arm held at rest.

    python -m benchmarks.control_law

The numbers are exact: the closed loop gives the same bits on each run.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.report import merge, print_table
from rx90_controller.lines.task import LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup

# A ramp that is over within rounding of zero: the sign function as written.
_LITERAL_SIGN = 1e-12  # rad/s
_FF_BLOCK = {f"controller.feed_forward.{part}": False for part in ("acceleration", "coulomb", "viscous")}
_PAPER_D = {"controller.feed_forward.velocity": False}
CASES: dict[str, tuple[str, dict[str, bool | float]]] = {
    "path_error_mm": ("as shipped", {}),
    "path_error_no_ff_mm": ("FF off", {**_FF_BLOCK}),
    "path_error_paper_d_mm": ("dq_r off", {**_PAPER_D}),
    "path_error_no_ff_paper_d_mm": ("FF and dq_r off", {**_FF_BLOCK, **_PAPER_D}),
    "path_error_literal_sign_mm": ("FF with a literal sign function", {"controller.coulomb_velocity": _LITERAL_SIGN}),
}
_POSE = (0.1, 0.5, 1.2, 0.2, 0.9, 0.3)  # rad, none of it on a count
_HELD, _LOOKED_AT = 4.0, 1.0  # s


def path_errors(setup: Setup, task: LineTask) -> dict[str, tuple[float, float]]:
    """Return worst and RMS path error of each case, m."""
    errors = {}
    for key, (_, changes) in CASES.items():
        path = run_line(with_parameters(setup, changes), task).path_accuracy
        errors[key] = path.worst, path.rms
    return errors


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
        [(CASES[key][0], f"{worst * 1e3:.3f}", f"{rms * 1e3:.3f}") for key, (worst, rms) in errors.items()],
    )
    extent, step = torque_at_rest(setup)
    print(f"held at rest: a joint's torque moves within {extent:.2f} Nm, by at most {step:.2f} Nm from tick to tick")
    figures = {key: worst * 1e3 for key, (worst, _) in errors.items()}
    merge({**figures, "torque_at_rest_range_nm": extent, "torque_at_rest_step_nm": step})
    return 0


if __name__ == "__main__":
    sys.exit(main())
