"""/tf and /tf_static from the simulation, over DDS."""

from contextlib import closing
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from processes import Processes
from ros_client import Client, seconds

from rx90_common.exchange.endpoints import LATCHED_QOS
from rx90_emulator.loop.setup import Setup

START = [0.4, -0.6, 1.2, 3.5, -0.9, -4.0]
FIXED = {"base_link_inertia", "flange", "tool0", "tool", "tcp"}


def misplaced(shipped: Setup, transform: Any, position: Any) -> float:
    """Return how far a transform is from Pinocchio's, m and entries of the rotation matrix."""
    model = shipped.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(position))
    parent, child = (
        data.oMf[model.getFrameId(name, pin.BODY)] for name in (transform.header.frame_id, transform.child_frame_id)
    )
    expected = parent.actInv(child)
    shift, turn = transform.transform.translation, transform.transform.rotation
    rotation = pin.Quaternion(np.array([turn.x, turn.y, turn.z, turn.w])).matrix()
    translation = np.array([shift.x, shift.y, shift.z])
    return float(max(abs(rotation - expected.rotation).max(), abs(translation - expected.translation).max()))


@pytest.mark.ros
@pytest.mark.usefixtures("needs_tf")
def test_frames_are_where_pinocchio_has_them(processes: Processes, shipped: Setup) -> None:
    """In a namespace each frame of the URDF has one transform, as Pinocchio's of the joint_states of the same stamp."""
    from tf2_msgs.msg import TFMessage

    with closing(Client("/cell_1")) as client:
        moving, joints = client.listen("tf", TFMessage), client.listen("joint_states")
        fixed: list[Any] = []
        client.node.create_subscription(TFMessage, "tf_static", fixed.append, LATCHED_QOS)
        processes.start(
            *("rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-r", "/tf:=tf", "-r", "/tf_static:=tf_static"),
            *("-p", "rx90_sim:tf_rate:=100", "-p", "rx90_sim:paused:=true", "-p", "rx90_sim:step_ticks:=81"),
            *("-p", f"rx90_sim:initial_position:={START}"),
        )
        client.spin_until(lambda: bool(moving) and bool(fixed) and bool(joints), "the frames before time runs")
        client.simulation.step()
        client.spin_until(lambda: len({seconds(m.transforms[0]) for m in moving}) == 3, "0.02 s")
        client.spin_until(lambda: seconds(joints[-1]) >= 0.02, "its joint states")
    positions = {seconds(message): message.position for message in joints}
    assert sorted({seconds(m.transforms[0]) for m in moving}) == pytest.approx([0.0, 0.01, 0.02])
    for message in moving:
        assert [one.child_frame_id for one in message.transforms] == [f"link_{i}" for i in range(1, 7)]
        for transform in message.transforms:
            assert misplaced(shipped, transform, positions[seconds(transform)]) < 1e-14
    assert {one.child_frame_id for one in fixed[-1].transforms} == FIXED
    assert max(misplaced(shipped, transform, START) for transform in fixed[-1].transforms) < 1e-14
    frames = {frame.name for frame in shipped.robot.model.frames if frame.type == pin.BODY}
    assert frames == {"base_link", *(f"link_{i}" for i in range(1, 7)), *FIXED}
