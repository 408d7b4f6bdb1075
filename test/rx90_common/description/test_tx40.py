"""The TX40's files hold the published values, written here once more in the form in which they are published."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import forward
from rx90_emulator.identification.arm import rigid_torque
from rx90_emulator.loop.setup import Setup

# BIRDy's TX40.m: modified Denavit-Hartenberg parameters, masses, first moments, and inertias Ixx, Ixy, Ixz, Iyy, Iyz,
# Izz about the origin of each link's frame.
THETA = (0.0, -math.pi / 2, math.pi / 2, 0.0, 0.0, math.pi)
A = (0.0, 0.0, 0.225, 0.0, 0.0, 0.0)
D = (0.0, 0.0, 0.035, 0.225, 0.0, 0.0)
ALPHA = (0.0, -math.pi / 2, 0.0, math.pi / 2, -math.pi / 2, math.pi / 2)
MASS = (8.61, 4.85, 4.07, 3.62, 1.02, 0.2)
FIRST_MOMENT = (
    (0.0, 0.0, -0.05 * 8.61),
    (0.392, -0.0072, 0.162),
    (0.0326, 0.0244, 0.265),
    (0.0145, -0.00724, -0.586),
    (0.0, -0.00306, -0.00102),
    (0.0, 0.0, 0.0084),
)
INERTIA = (
    (0.424, 0.0, 0.0, 0.424, 0.0, 0.352),
    (1.63e-2, 7.85e-4, -1.57e-2, 8.81e-2, 3.24e-4, 8.28e-2),
    (2.23e-2, -1.95e-4, -1.16e-3, 2.24e-2, -2.22e-3, 4.41e-3),
    (1.09e-1, 2.9e-5, 1.35e-3, 1.08e-1, -1.17e-3, 4.07e-3),
    (1.01e-3, 0.0, 0.0, 1.00e-3, -3.06e-6, 1.01e-3),
    (3.53e-3, 0.0, 0.0, 3.53e-3, 0.0, 3.53e-4),
)
ROTOR = (0.362, 0.507, 0.0829, 0.0341, 0.0361, 0.0114)


def frames(q: Array) -> list[tuple[Array, Array]]:
    """Return rotation and origin of each DH frame in the one before it."""
    found = []
    for i in range(6):
        c, s, ca, sa = math.cos(q[i] + THETA[i]), math.sin(q[i] + THETA[i]), math.cos(ALPHA[i]), math.sin(ALPHA[i])
        rotation = np.array([[c, -s, 0.0], [ca * s, ca * c, -sa], [sa * s, sa * c, ca]])
        found.append((rotation, np.array([A[i], -sa * D[i], ca * D[i]])))
    return found


def newton_euler(q: Array, v: Array, a: Array) -> Array:
    """Return the links' torque on the joints by the recursion in the DH frames (Khalil and Dombre), Nm, shape (6,)."""
    z = np.array([0.0, 0.0, 1.0])
    omega, alpha, acceleration = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.81])
    chain, wrenches = frames(q), []
    for i, (rotation, origin) in enumerate(chain):
        acceleration = rotation.T @ (
            acceleration + np.cross(alpha, origin) + np.cross(omega, np.cross(omega, origin))
        )  # fmt: skip
        turned = rotation.T @ omega
        alpha = rotation.T @ alpha + a[i] * z + np.cross(turned, v[i] * z)
        omega = turned + v[i] * z
        xx, xy, xz, yy, yz, zz = INERTIA[i]
        inertia, moment = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array(FIRST_MOMENT[i])
        force = MASS[i] * acceleration + np.cross(alpha, moment) + np.cross(omega, np.cross(omega, moment))
        torque = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(moment, acceleration)
        wrenches.append((force, torque))
    force, torque, result = np.zeros(3), np.zeros(3), np.zeros(6)
    for i in reversed(range(6)):
        force, torque = force + wrenches[i][0], torque + wrenches[i][1]
        result[i] = torque[2]
        rotation, origin = chain[i]
        force = rotation @ force
        torque = rotation @ torque + np.cross(origin, force)
    return result


def test_the_torque_is_that_of_the_published_parameters(tx40: Setup) -> None:
    """At random states the URDF gives the torque of the published DH parameters, and motor 6's rotor acts twice."""
    rng = np.random.default_rng(40)
    q, v, a = (scale * rng.uniform(-1.0, 1.0, (40, 6)) for scale in (3.0, 4.0, 20.0))
    want = np.array([newton_euler(*state) for state in zip(q, v, a, strict=True)])
    want[:, :5] += a[:, :5] * ROTOR[:5]
    want[:, 4:] += (ROTOR[5] * (a[:, 4] + a[:, 5]))[:, None]
    got = rigid_torque(tx40.robot.model, tx40.drives.rotor_matrix, tx40.drives.spring_torque, q, v, a)
    assert np.abs(got - want).max() < 1e-10 * np.abs(want).max()


def test_the_links_are_physically_consistent(tx40: Setup) -> None:
    """A mass density that is nowhere negative can have each link's pseudo-inertia matrix: it is positive definite."""
    for inertia in tx40.robot.model.inertias[1:]:
        about_origin = np.asarray(inertia.inertia) - inertia.mass * np.asarray(
            pin.skewSquare(inertia.lever, inertia.lever)
        )
        pseudo = np.zeros((4, 4))
        pseudo[:3, :3] = 0.5 * np.trace(about_origin) * np.eye(3) - about_origin
        pseudo[:3, 3] = pseudo[3, :3] = inertia.mass * inertia.lever
        pseudo[3, 3] = inertia.mass
        assert np.linalg.eigvalsh(pseudo).min() > 0.0


def test_reach_and_limits_are_the_published_ones(tx40: Setup) -> None:
    """Straight up the flange is 0.515 m above joint 2 and 35 mm to the side; ranges and speeds are the published."""
    robot = tx40.robot
    assert forward(robot.chain, np.zeros((1, 6))).position[0] == pytest.approx([0.0, 0.035, 0.32 + 0.515], abs=1e-12)
    assert np.degrees(robot.upper) == pytest.approx([180, 125, 138, 270, 133.5, 270])
    assert np.degrees(robot.lower) == pytest.approx([-180, -125, -138, -270, -120, -270])
    assert np.degrees(robot.max_velocity) == pytest.approx([287, 287, 430, 410, 320, 700])
    limits = tx40.cs7b().trajectory.limits  # those that a trajectory is held against
    assert (limits.upper.tolist(), limits.velocity.tolist()) == (robot.upper.tolist(), robot.max_velocity.tolist())
    assert limits.acceleration.tolist() == [50.0] * 6


def test_drives_and_friction_are_the_published_ones(tx40: Setup) -> None:
    """Gear, drive gains at the joint, peak torque, Coulomb and viscous friction; motor 6's share counts once."""
    drives, elements = tx40.drives, tx40.friction.elements
    assert drives.gear.tolist() == [32, 32, 45, -48, 45, 32]
    gain = np.abs(drives.gear) * drives.torque_constant
    assert gain == pytest.approx([35.24, 32.04, 23.94, 9.05, 15.5, 6.56], rel=1e-9)
    assert gain * drives.peak_current == pytest.approx(tx40.robot.max_effort, rel=1e-7)
    coulomb = [e.tau_c_positive for e in elements]
    assert coulomb == [e.tau_c_negative for e in elements] == [7.14, 8.26, 6.34, 2.48, 3.03, 0.282, 1.95]
    viscous = np.array([e.c2 for e in elements])
    assert viscous[:4].tolist() == [8.05, 5.53, 1.97, 1.11]
    assert viscous[4:6] + viscous[6] == pytest.approx([1.86, 0.65])
    assert viscous[6] == 0.616
    assert tx40.controller.coulomb[:5].tolist() == coulomb[:5]
    assert tx40.controller.viscous == pytest.approx([*viscous[:5], 0.65])
    assert tx40.friction.passivity_warnings(tx40.drives.turning.reach(tx40.robot.max_velocity)) == []
