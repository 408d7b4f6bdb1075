"""The constants that compiled code gets are those of the URDF and the tool file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rx90_common.description.kinematics import forward
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.loop.setup import Setup


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
    assert shipped_files.tool is not None
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


def test_a_missing_mesh_does_not_matter(shipped_files: RobotFiles, tmp_path: Path) -> None:
    """A URDF whose mesh file is not there loads: looks are not needed to move."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    box = '<box size="0.060 0.120 0.090"/>'
    assert box in text
    file = tmp_path / "meshes.urdf"
    file.write_text(text.replace(box, '<mesh filename="package://nowhere/base.stl"/>'), encoding="utf-8")
    np.testing.assert_array_equal(load_robot(file).chain.mass, load_robot(shipped_files.urdf).chain.mass)
