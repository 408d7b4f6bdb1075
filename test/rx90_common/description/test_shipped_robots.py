"""The shipped robots against what is published of them."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from rx90_common.base.arrays import Array
from rx90_common.base.share import config_path
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.setup import Setup


def serial_arm(rows: Iterable[tuple[float, float, float, float]], bodies: Sequence[pin.Inertia]) -> pin.Model:
    """Return the arm of modified Denavit-Hartenberg parameters a, d, alpha, theta."""
    model = pin.Model()
    for k, ((a, d, alpha, theta), body) in enumerate(zip(rows, bodies, strict=True)):
        turn = pin.rpy.rpyToMatrix(alpha, 0.0, 0.0)
        place = pin.SE3(turn @ pin.rpy.rpyToMatrix(0.0, 0.0, theta), turn @ [0.0, 0.0, d] + [a, 0.0, 0.0])
        joint = model.addJoint(k, pin.JointModelRZ(), place, f"joint_{k + 1}")
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return model


def test_masses_with_and_without_tool(shipped_files: RobotFiles) -> None:
    """The arm weighs 111 kg; the tool adds 3.5 kg to the last link and moves its centre of mass."""
    bare, tooled = load_robot(shipped_files.urdf), load_robot(shipped_files.urdf, shipped_files.tool)
    base = 22.5
    assert bare.chain.mass.sum() + base == pytest.approx(111.0, abs=1e-12)
    np.testing.assert_allclose(tooled.chain.mass - bare.chain.mass, [0, 0, 0, 0, 0, 3.5], atol=1e-12)
    # Two points on the axis: 0.2 kg at -8 mm and 3.5 kg at 100 mm from the flange.
    assert tooled.chain.com[5, 2] == pytest.approx((0.2 * -0.008 + 3.5 * 0.1) / 3.7, abs=1e-15)
    assert (bare.tcp_frame, tooled.tcp_frame) == ("tool0", "tcp")
    assert {"base_link", "link_6", "flange", "tool0", "tool", "tcp"} <= {
        link.get("name") for link in ET.fromstring(tooled.urdf).findall("link")
    }
    np.testing.assert_array_equal(bare.chain.tcp_position, np.zeros(3))


def test_the_tool_centre_point_is_as_the_file_says(shipped_files: RobotFiles, edited_yaml: Callable[..., Path]) -> None:
    """Its position, m, and roll, pitch and yaw about fixed axes, degrees, are in the axes of link tool0."""
    tool = edited_yaml(shipped_files.tool, ("tcp",), {"position": [0.01, -0.02, 0.2], "rpy_degrees": [10, -20, 130]})
    q = np.array([0.1, 0.5, 1.2, -0.3, 0.9, 0.4])
    mount, point = (forward(load_robot(shipped_files.urdf, file).chain, q) for file in (None, tool))
    np.testing.assert_allclose(point.position, mount.position + mount.rotation @ [0.01, -0.02, 0.2], atol=1e-14)
    turned = Rotation.from_euler("xyz", [10, -20, 130], degrees=True).as_matrix()
    np.testing.assert_allclose(point.rotation, mount.rotation @ turned, atol=1e-14)


def test_published_limits(shipped: Setup) -> None:
    """Joint limits and speeds are the published ones, in degrees."""
    robot = shipped.robot
    np.testing.assert_allclose(np.degrees(robot.lower), [-160, -137.5, -142.5, -270, -105, -270], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(robot.upper), [160, 137.5, 142.5, 270, 120, 270], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(robot.max_velocity), [236, 200, 286, 401, 320, 580], rtol=1e-14)


def test_published_dimensions(shipped_files: RobotFiles) -> None:
    """Straight up the flange is 0.42 + 0.985 m high; the arm reaches 0.985 m from axis 2 to any side."""
    chain = load_robot(shipped_files.urdf).chain
    right = np.pi / 2
    for shoulder, elbow, place in ((0, 0, [0, 0, 1.405]), (right, 0, [0.985, 0, 0.42]), (0, right, [0.535, 0, 0.87])):
        pose = np.array([0.0, shoulder, elbow, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(forward(chain, pose).position, place, atol=1e-15)


def test_angle_map_to_the_published_convention(shipped_files: RobotFiles) -> None:
    """With theta = (q1, pi/2-q2, -pi/2-q3, q4, -q5, q6) the published table gives the same wrist pose."""
    robot = load_robot(shipped_files.urdf)
    rng = np.random.default_rng(5)
    offsets = []
    alpha = np.radians([0, 90, 0, -90, 90, -90])
    rows = zip((0, 0, 0.45, 0, 0, 0), (0, 0, 0, 0.45, 0, 0), alpha, np.zeros(6), strict=True)
    model = serial_arm(rows, [pin.Inertia.Zero()] * 6)  # as Khalil and Kleinfinger have it
    data = model.createData()
    for _ in range(20):
        q = rng.uniform(robot.lower, robot.upper)
        theta = np.array([q[0], np.pi / 2 - q[1], -np.pi / 2 - q[2], q[3], -q[4], q[5]])
        pin.forwardKinematics(model, data, theta)
        published = data.oMi[6]
        pose = forward(robot.chain, q)
        wrist = pose.position - 0.085 * pose.rotation[:, 2]
        np.testing.assert_allclose(wrist - [0, 0, 0.42], published.translation, atol=1e-14)
        offsets.append(pose.rotation.T @ published.rotation)
    # The conventions differ by one fixed rotation of the last frame, which keeps axis 6.
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], (20, 3, 3)), atol=1e-14)
    np.testing.assert_allclose(offsets[0][:, 2], [0, 0, 1], atol=1e-14)


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


def torques(model: pin.Model, q: Array, v: Array, a: Array) -> Array:
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])


def test_the_torque_is_that_of_the_published_parameters(tx40: Setup) -> None:
    """At random states the URDF gives the torque of the published DH parameters, and motor 6's rotor acts twice."""
    rng = np.random.default_rng(40)
    q, v, a = (scale * rng.uniform(-1.0, 1.0, (40, 6)) for scale in (3.0, 4.0, 20.0))
    bodies = [
        pin.Inertia.FromDynamicParameters(np.array([mass, *moment, xx, xy, yy, xz, yz, zz]))
        for mass, moment, (xx, xy, xz, yy, yz, zz) in zip(MASS, FIRST_MOMENT, INERTIA, strict=True)
    ]
    want = torques(serial_arm(zip(A, D, ALPHA, THETA, strict=True), bodies), q, v, a)
    want[:, :5] += a[:, :5] * ROTOR[:5]
    want[:, 4:] += (ROTOR[5] * (a[:, 4] + a[:, 5]))[:, None]
    got = rigid_torque(tx40.robot.model, tx40.drives.rotor_matrix, tx40.drives.spring_torque, q, v, a)
    assert np.abs(got - want).max() < 1e-10 * np.abs(want).max()


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
    coulomb = [e.tau_c.positive for e in elements]
    assert coulomb == [e.tau_c.negative for e in elements] == [7.14, 8.26, 6.34, 2.48, 3.03, 0.282, 1.95]
    viscous = np.array([e.c2 for e in elements])
    assert viscous[:4].tolist() == [8.05, 5.53, 1.97, 1.11]
    assert viscous[4:6] + viscous[6] == pytest.approx([1.86, 0.65])
    assert viscous[6] == 0.616
    assert list(tx40.controller.feed_forward.coulomb_torque[:5]) == coulomb[:5]
    assert tx40.controller.feed_forward.viscous_friction == pytest.approx([*viscous[:5], 0.65])
    assert tx40.friction.passivity_warnings(tx40.drives.turning.reach(tx40.robot.max_velocity)) == []


# Franka Control Interface: modified Denavit-Hartenberg parameters a, d, alpha.
HALF = math.pi / 2
DH = (
    (0.0, 0.333, 0.0), (0.0, 0.0, -HALF), (0.0, 0.316, HALF), (0.0825, 0.0, HALF), (-0.0825, 0.384, -HALF),
    (0.0, 0.0, HALF), (0.088, 0.0, HALF),
)  # fmt: skip
FLANGE = 0.107
# Gaz and others (2019), by franka_ros: mass, centre of mass, inertia Ixx, Ixy, Ixz, Iyy, Iyz, Izz about that.
LINKS = (
    (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117)),
    (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995)),
    (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083)),
    (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323)),
    (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627)),
    (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433)),
    (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815)),
)


@pytest.fixture(scope="module")
def panda() -> Setup:
    return Setup.load(RobotFiles.named("panda"))


@pytest.fixture(scope="module")
def published() -> pin.Model:
    bodies = []
    for mass, center, (xx, xy, xz, yy, yz, zz) in LINKS:
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        bodies.append(pin.Inertia(mass, np.array(center), inertia))
    return serial_arm([(*row, 0.0) for row in DH], bodies)


def test_the_flange_is_where_the_published_frames_put_it(panda: Setup, published: pin.Model) -> None:
    """In random poses the tool centre point is that of the Denavit-Hartenberg parameters, to rounding."""
    data = published.createData()
    for q in np.random.default_rng(1).uniform(panda.robot.lower, panda.robot.upper, (20, 7)):
        pin.forwardKinematics(published, data, q)
        flange = data.oMi[7].act(np.array([0.0, 0.0, FLANGE]))
        np.testing.assert_allclose(forward(panda.robot.chain, q)[0], flange, rtol=0.0, atol=1e-12)


def test_the_torques_are_those_of_the_published_model(panda: Setup, published: pin.Model) -> None:
    """Along motions like those identified from, the bodies' torques are within 4 % of those by Gaz, over all joints."""
    rng, robot = np.random.default_rng(2), panda.robot
    middle, reach = (robot.lower + robot.upper) / 2.0, (robot.upper - robot.lower) / 2.0
    q = middle + 0.6 * reach * rng.uniform(-1.0, 1.0, (300, 7))
    v, a = (0.5 * rng.uniform(-1.0, 1.0, (300, 7)) * scale for scale in (robot.max_velocity, 4.0))
    got, want = (torques(model, q, v, a) for model in (robot.model, published))
    assert np.linalg.norm(got - want) < 0.04 * np.linalg.norm(want)
    assert (np.linalg.norm(got - want, axis=0) > 0.0).all(), "the published model itself, not an identified one"


def test_limits_and_friction_are_those_of_their_sources(panda: Setup) -> None:
    """Joint space limits are the manufacturer's; the friction is the library's, and says how well it is known."""
    robot = panda.robot
    assert robot.lower.tolist() == [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    assert robot.upper.tolist() == [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    assert robot.max_velocity.tolist() == [2.175] * 4 + [2.61] * 3
    assert robot.max_effort.tolist() == [87.0] * 4 + [12.0] * 3
    assert panda.cs7b().trajectory.limits.acceleration.tolist() == [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]
    own, library = (
        FrictionFile.read(config_path(name))
        for name in ("robots/panda/friction.yaml", "friction/library/panda_gaz.yaml")
    )
    assert own.elements == library.elements
    assert own.identification["parameters"].keys() == own.elements.entries.keys()
