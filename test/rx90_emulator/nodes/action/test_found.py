"""The controller is found by rqt_joint_trajectory_controller and MoveIt as one of a controller_manager, and is used."""

from typing import Any

import numpy as np
import pytest
from action_bench import STEP, SUCCEEDED, Bench
from ros_client import JOINTS

from rx90_emulator.loop.setup import Setup

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("needs_manager")]
NAME = "rx90_controller"


def test_rqt_finds_it_and_its_sliders_move_it(bench: Bench, shipped: Setup) -> None:
    """One manager, one running controller, six joints with limits in robot_description; a slider's points arrive."""
    from action_client import move
    from controller_clients import Rqt
    from trajectory_msgs.msg import JointTrajectory

    rqt, client = Rqt(bench.client), bench.client
    client.spin_until(lambda: rqt.managers() == ["/controller_manager"], "a controller manager")
    (controller,) = rqt.running("/controller_manager")
    assert rqt.joint_names(controller) == JOINTS
    space = f"/{controller.name}"  # `_resolve_controller_ns`
    topics = dict(client.node.get_topic_names_and_types())
    assert topics[f"{space}/controller_state"] == ["control_msgs/msg/JointTrajectoryControllerState"]
    assert topics[f"{space}/joint_trajectory"] == ["trajectory_msgs/msg/JointTrajectory"]
    assert "/robot_description" in topics
    bench.home()
    to = 0.1
    message: Any = move(to, max(to / float(shipped.robot.max_velocity.min()), 0.5) / 0.5).trajectory  # `_update_cmd_cb`
    message.points[0].velocities = []
    publisher = client.node.create_publisher(JointTrajectory, f"{space}/joint_trajectory", 1)
    client.spin_until(lambda: publisher.get_subscription_count() > 0, "the controller")
    publisher.publish(message)
    bench.said("trajectory accepted: 1 point, 1.000 s")
    bench.time.run(1.1)
    assert np.array(bench.heard()[-1].position) == pytest.approx([to] * 6)


def test_moveit_finds_it_and_calls_its_action(bench: Bench) -> None:
    """Ros2ControlManager has one active controller with six joints, and a goal succeeds; none while it is inactive."""
    from action_client import move
    from controller_clients import MoveIt, Rqt

    bench.client.spin_until(lambda: MoveIt.namespaces(bench.client) == ["/"], "a controller manager")
    manager = MoveIt(bench.client)
    assert manager.active == {NAME: JOINTS}
    assert list(manager.managed) == [f"/{NAME}"]
    assert manager.managed[f"/{NAME}"].required_command_interfaces == [f"{joint}/position" for joint in JOINTS]
    assert bench.follow(move(0.05, 0.5)).status == SUCCEEDED
    assert bench.client.transition(NAME, "deactivate")
    manager.discover()
    assert manager.active == {}
    assert manager.managed[f"/{NAME}"].state == "inactive"
    assert Rqt(bench.client).running("/controller_manager") == []
    assert bench.client.transition(NAME, "activate")
    bench.time.run(STEP)  # the torque comes back with a tick
    manager.discover()
    assert manager.active == {NAME: JOINTS}


def test_what_cannot_be_exchanged_is_answered_so(bench: Bench) -> None:
    """Load, unload, configure, clean up, reload and a switch are refused, the last with a reason; the arm goes on."""
    from controller_clients import MoveIt
    from controller_manager_msgs import srv

    call = bench.client.asking.call
    for name in ("Load", "Unload", "Configure", "Cleanup"):
        kind = getattr(srv, f"{name}Controller")
        assert not call(kind, f"controller_manager/{name.lower()}_controller", kind.Request(name=NAME)).ok
        bench.said(f"{name.lower()}_controller: rx90_controller is the drive of its arm, and the only controller")
    reload = srv.ReloadControllerLibraries
    assert not call(reload, "controller_manager/reload_controller_libraries", reload.Request()).ok
    switch = srv.SwitchController
    request = switch.Request(deactivate_controllers=[NAME], strictness=switch.Request.STRICT)
    answer = call(switch, "controller_manager/switch_controller", request)
    assert (answer.ok, answer.message.split(";")[0]) == (False, "rx90_controller is active")
    assert answer.message.endswith("accepted: ~/enable and the node's life cycle switch it")
    request = switch.Request(activate_controllers=["other"], strictness=switch.Request.BEST_EFFORT)
    assert "unknown: 'other'" in call(switch, "controller_manager/switch_controller", request).message
    request.activate_controllers = [NAME]
    assert call(switch, "controller_manager/switch_controller", request).ok
    assert MoveIt(bench.client).active == {NAME: JOINTS}


def test_interfaces_and_hardware_are_those_of_the_arm(bench: Bench, shipped: Setup) -> None:
    """Positions are commanded and claimed, positions and velocities measured; one active system, the robot."""
    from controller_manager_msgs import srv

    def ask(kind: Any, name: str) -> Any:
        return bench.client.asking.call(kind, f"controller_manager/{name}", kind.Request())

    listed = ask(srv.ListHardwareInterfaces, "list_hardware_interfaces")
    commands = [(each.name, each.data_type, each.is_available, each.is_claimed) for each in listed.command_interfaces]
    assert commands == [(f"{joint}/position", "double", True, True) for joint in JOINTS]
    states = [(each.name, each.is_available, each.is_claimed) for each in listed.state_interfaces]
    assert states == [(f"{joint}/{each}", True, False) for joint in JOINTS for each in ("position", "velocity")]
    (component,) = ask(srv.ListHardwareComponents, "list_hardware_components").component
    assert (component.name, component.type, component.state.label) == (shipped.robot.model.name, "system", "active")
    types = ask(srv.ListControllerTypes, "list_controller_types")
    assert types.types == ["joint_trajectory_controller/JointTrajectoryController"]
