"""The arm held at rest: what the last count of the position does to the torque."""

from __future__ import annotations

import math

import numpy as np

from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup


def test_at_rest_the_torque_steps_by_no_more_than_one_count_of_the_position(shipped: Setup) -> None:
    """Held for a second, each torque's steps are the proportional gain times one count, and stay within two of them."""
    pose = np.array([0.1, 0.5, 1.2, 0.2, 0.9, 0.3])
    points = TrajectoryPoints(np.array([0.0, 1.5]), np.array([pose, pose]), None, None)
    run = simulate(shipped, points, record_fast=True)
    assert run.fast is not None
    torque = shipped.drives.gear * run.fast.motor_commands[4000:]  # Nm at the joint, the last 0.5 s
    law, count = shipped.controller, 2 * math.pi / shipped.drives.encoder_counts / shipped.drives.gear
    one_count = law.inertia * law.kv * law.kp * count
    assert np.all(np.abs(np.diff(torque, axis=0)).max(axis=0) <= 1.02 * one_count)
    assert np.any(np.abs(np.diff(torque, axis=0)).max(axis=0) > 0.1 * one_count)
