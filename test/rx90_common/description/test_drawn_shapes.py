"""What is drawn of an arm whose URDF has no shapes that can be drawn."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.shapes import drawn_shapes

MESH = '<visual><geometry><mesh filename="package://nowhere/link.stl"/></geometry></visual>'


@pytest.mark.parametrize("visual", ["", MESH])
def test_rods_lead_from_joint_to_joint(tmp_path: Path, visual: str) -> None:
    """Without shapes, or with meshes that are not there, rods in any pose reach from each joint to the next."""
    text = re.sub(r"<visual.*?</visual>", "", RobotFiles().urdf.read_text(encoding="utf-8"), flags=re.DOTALL)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text.replace("</inertial>", f"</inertial>{visual}", 3), encoding="utf-8")
    robot = load_robot(urdf)
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.linspace(-0.5, 1.0, 6))
    stops = [np.zeros(3), *(data.oMi[k + 1].translation for k in range(6))]
    stops.append(data.oMf[model.getFrameId(robot.tcp_frame)].translation)
    ways = [(a, b) for a, b in pairwise(stops) if np.linalg.norm(b - a) > 0.06]
    rods = [shape for shape in drawn_shapes(robot) if shape.kind == "Cylinder"]
    assert len(rods) == len(ways) > 2
    for rod, way in zip(rods, ways, strict=True):
        place = data.oMi[rod.joint + 1]
        half = place.rotation @ rod.rotation[:, 2] * rod.half[2]
        center = place.act(rod.position)
        np.testing.assert_allclose([center - half, center + half], way, atol=1e-9)
