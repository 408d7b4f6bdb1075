"""The constants that compiled code gets are those of the URDF and the tool file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from rx90_common.description.chain import RigidChain
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.loop.setup import Setup


def _links(chain: RigidChain, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return position and rotation of each link by the chain's definition, one link after the other."""
    position, rotation, links = np.zeros(3), np.eye(3), []
    for origin, axis, angle in zip(chain.origin, chain.axis, q, strict=True):
        position = position + rotation @ origin
        rotation = rotation @ Rotation.from_rotvec(axis * angle).as_matrix()
        links.append((position, rotation))
    return links


def _mass_matrix(chain: RigidChain, q: np.ndarray) -> np.ndarray:
    """Return sum(m Jv' Jv + Jw' I Jw) over the links, from the chain alone."""
    links = _links(chain, q)
    frames = [np.eye(3)] + [rotation for _, rotation in links[:-1]]
    axes = [rotation @ axis for rotation, axis in zip(frames, chain.axis, strict=True)]
    total = np.zeros((6, 6))
    for i, (position, rotation) in enumerate(links):
        com = position + rotation @ chain.com[i]
        linear, angular = np.zeros((3, 6)), np.zeros((3, 6))
        for j in range(i + 1):
            linear[:, j] = np.cross(axes[j], com - links[j][0])
            angular[:, j] = axes[j]
        xx, yy, zz, xy, xz, yz = chain.inertia[i]
        inertia = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
        total += chain.mass[i] * linear.T @ linear + angular.T @ inertia @ angular
    return total


def _check_against_pinocchio(robot: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = robot.model.createData()
    for _ in range(5):
        q = rng.uniform(robot.lower, robot.upper)
        pin.framesForwardKinematics(robot.model, data, q)
        for i, (position, _) in enumerate(_links(robot.chain, q)):
            np.testing.assert_allclose(position, data.oMi[i + 1].translation, atol=1e-12)
        tcp = data.oMf[robot.model.getFrameId(robot.tcp_frame)]
        pose = forward(robot.chain, q)
        np.testing.assert_allclose(pose.position, tcp.translation, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, tcp.rotation, atol=1e-12)
        oracle = np.triu(pin.crba(robot.model, data, q))
        oracle = oracle + np.triu(oracle, 1).T
        np.testing.assert_allclose(_mass_matrix(robot.chain, q), oracle, rtol=1e-11, atol=1e-12)


def test_chain_of_the_rx90_is_the_urdf_seen_by_pinocchio(shipped: Setup) -> None:
    """Link positions, the tool centre point and the mass matrix of the chain are Pinocchio's."""
    _check_against_pinocchio(shipped.robot, 1)


@pytest.mark.parametrize("seed", range(4))
def test_chain_of_any_serial_arm_is_the_urdf_seen_by_pinocchio(
    random_arm: Callable[[int], Path], shipped_files: RobotFiles, seed: int
) -> None:
    """Arms with arbitrary frames, axes and a side branch become the same mechanism with parallel frames."""
    robot = load_robot(random_arm(seed), shipped_files.tool)
    assert robot.joint_names == ("turn_9", "turn_8", "turn_7", "turn_6", "turn_5", "turn_4")
    np.testing.assert_array_equal(robot.max_effort, np.arange(10.0, 16.0))
    _check_against_pinocchio(robot, seed)


def test_frames_of_the_chain_are_parallel_to_the_base_at_zero(random_arm: Callable[[int], Path]) -> None:
    """The centre of mass and the axes in base axes at q = 0 are read off the chain without any rotation."""
    robot = load_robot(random_arm(11))
    data = robot.model.createData()
    com = pin.centerOfMass(robot.model, data, np.zeros(6))
    chain = robot.chain
    by_hand = chain.mass @ (np.cumsum(chain.origin, axis=0) + chain.com) / chain.mass.sum()
    np.testing.assert_allclose(by_hand, com, atol=1e-13)


def test_constants_are_arrays_that_compiled_code_takes(shipped: Setup) -> None:
    """Every array of the chain is C-contiguous float64 of the documented shape."""
    shapes = [(6, 3), (6, 3), (6,), (6, 3), (6, 6), (3,), (3,), (3, 3)]
    assert [array.shape for array in shipped.robot.chain] == shapes
    assert all(array.dtype == np.float64 and array.flags.c_contiguous for array in shipped.robot.chain)


def test_masses_with_and_without_tool(shipped_files: RobotFiles) -> None:
    """The arm weighs 111 kg; the tool adds 3.5 kg to the last link and moves its centre of mass."""
    bare, tooled = load_robot(shipped_files.urdf), load_robot(shipped_files.urdf, shipped_files.tool)
    base = 22.5
    assert bare.chain.mass.sum() + base == pytest.approx(111.0, abs=1e-12)
    np.testing.assert_allclose(tooled.chain.mass - bare.chain.mass, [0, 0, 0, 0, 0, 3.5], atol=1e-12)
    # Two points on the axis: 0.2 kg at -8 mm and 3.5 kg at 100 mm from the flange.
    assert tooled.chain.com[5, 2] == pytest.approx((0.2 * -0.008 + 3.5 * 0.1) / 3.7, abs=1e-15)
    assert bare.tcp_frame == "tool0"
    np.testing.assert_array_equal(bare.chain.tcp_position, np.zeros(3))


def test_published_limits(shipped: Setup) -> None:
    """Joint limits and speeds are the published ones, in degrees."""
    robot = shipped.robot
    np.testing.assert_allclose(np.degrees(robot.lower), [-160, -137.5, -142.5, -270, -105, -270], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(robot.upper), [160, 137.5, 142.5, 270, 120, 270], rtol=1e-14)
    np.testing.assert_allclose(np.degrees(robot.max_velocity), [236, 200, 286, 401, 320, 580], rtol=1e-14)


def test_published_dimensions(shipped_files: RobotFiles) -> None:
    """Straight up the flange is 0.42 + 0.985 m high; the arm reaches 0.985 m from axis 2 to any side."""
    chain = load_robot(shipped_files.urdf).chain
    np.testing.assert_allclose(forward(chain, np.zeros(6)).position, [0, 0, 1.405], atol=1e-15)
    np.testing.assert_allclose(
        forward(chain, np.array([0.0, np.pi / 2, 0, 0, 0, 0])).position, [0.985, 0, 0.42], atol=1e-15
    )
    np.testing.assert_allclose(
        forward(chain, np.array([0.0, 0, np.pi / 2, 0, 0, 0])).position, [0.535, 0, 0.87], atol=1e-15
    )


def _khalil_kleinfinger(theta: np.ndarray) -> np.ndarray:
    """Return T06 of the published modified Denavit-Hartenberg parameters, coded from their definition."""
    alpha = np.radians([0, 90, 0, -90, 90, -90])
    d, r = [0, 0, 0.45, 0, 0, 0], [0, 0, 0, 0.45, 0, 0]
    transform = np.eye(4)
    for j in range(6):
        ca, sa, ct, st = np.cos(alpha[j]), np.sin(alpha[j]), np.cos(theta[j]), np.sin(theta[j])
        transform = transform @ np.array(
            [
                [ct, -st, 0, d[j]],
                [ca * st, ca * ct, -sa, -r[j] * sa],
                [sa * st, sa * ct, ca, r[j] * ca],
                [0, 0, 0, 1],
            ]
        )
    return transform


def test_angle_map_to_the_published_convention(shipped_files: RobotFiles) -> None:
    """With theta = (q1, pi/2-q2, -pi/2-q3, q4, -q5, q6) the published table gives the same wrist pose."""
    robot = load_robot(shipped_files.urdf)
    rng = np.random.default_rng(5)
    offsets = []
    for _ in range(20):
        q = rng.uniform(robot.lower, robot.upper)
        theta = np.array([q[0], np.pi / 2 - q[1], -np.pi / 2 - q[2], q[3], -q[4], q[5]])
        published = _khalil_kleinfinger(theta)
        pose = forward(robot.chain, q)
        wrist = pose.position - 0.085 * pose.rotation[:, 2]
        np.testing.assert_allclose(wrist - [0, 0, 0.42], published[:3, 3], atol=1e-14)
        offsets.append(pose.rotation.T @ published[:3, :3])
    # The conventions differ by one fixed rotation of the last frame, which keeps axis 6.
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], (20, 3, 3)), atol=1e-14)
    np.testing.assert_allclose(offsets[0][:, 2], [0, 0, 1], atol=1e-14)


def test_robot_description_holds_tool_and_spot(shipped: Setup) -> None:
    """The merged text is a URDF with links tool and tcp, and Pinocchio finds the tool's mass in it."""
    root = ET.fromstring(shipped.robot.urdf)
    names = {link.get("name") for link in root.findall("link")}
    assert {"base_link", "link_1", "link_6", "flange", "tool0", "tool", "tcp"} <= names
    model = pin.buildModelFromXML(shipped.robot.urdf)
    assert model.inertias[6].mass == pytest.approx(3.7)


def test_a_missing_mesh_does_not_matter(shipped_files: RobotFiles, tmp_path: Path) -> None:
    """A URDF whose mesh file is not there loads: looks are not needed to move."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    box = '<box size="0.060 0.120 0.090"/>'
    assert box in text
    file = tmp_path / "meshes.urdf"
    file.write_text(text.replace(box, '<mesh filename="package://nowhere/base.stl"/>'), encoding="utf-8")
    np.testing.assert_array_equal(load_robot(file).chain.mass, load_robot(shipped_files.urdf).chain.mass)


def test_loading_twice_gives_the_same_bits(shipped_files: RobotFiles) -> None:
    """The constants and the merged text do not depend on anything but the files."""
    first, second = (load_robot(shipped_files.urdf, shipped_files.tool) for _ in range(2))
    assert first.urdf == second.urdf
    assert all(np.array_equal(a, b) for a, b in zip(first.chain, second.chain, strict=True))
