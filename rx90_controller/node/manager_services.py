"""The services of a controller_manager, which describe this controller as a joint_trajectory_controller.

The controller is the arm's drive: no other controller can be loaded or replace it, and such requests are
answered accordingly. Names, types and meaning are those of ros2_control's controller_manager (Jazzy). To be imported
only if controller_manager_msgs is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from controller_manager_msgs.msg import ControllerState, HardwareComponentState, HardwareInterface
from controller_manager_msgs.srv import (
    CleanupController,
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    ListHardwareComponents,
    ListHardwareInterfaces,
    LoadController,
    ReloadControllerLibraries,
    SetHardwareComponentState,
    SwitchController,
    UnloadController,
)
from lifecycle_msgs.msg import State
from rclpy.node import Node

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.exchange.endpoints import REQUEST_QOS
from rx90_common.exchange.pacing import ThrottledLog
from rx90_controller.node.parameters import COMMAND_INTERFACES, STATE_INTERFACES
from rx90_controller.node.servo_loop import ServoLoop

TYPE = "joint_trajectory_controller/JointTrajectoryController"
"""The type by which MoveIt and rqt_joint_trajectory_controller know whom to speak to, and how."""
_BASE_CLASS = "controller_interface::ControllerInterface"
_COMPONENT_TYPE = "system"
_FIXED = (
    "is the drive of its arm, and the only controller: nothing is loaded, unloaded or exchanged"
)
_ANOTHER_WAY = "~/enable and the node's life cycle switch it"


class ManagerServices:
    """The services of a controller_manager whose one controller is this node.

    Args:
        node: whose services they are, and whose name is the controller's.
        manager: name of the manager, relative or absolute, below which they are.
        loop: reports whether the controller is active.
        joint_names: of the arm.
        robot: name of the arm, the hardware component.
        rates: of set-points and of the exchange with the arm, Hz.
    """

    def __init__(
        self,
        node: Node,
        manager: str,
        loop: ServoLoop,
        joint_names: Sequence[str],
        robot: str,
        rates: tuple[int, int],
    ) -> None:
        self._name = node.get_name()
        self._loop = loop
        self._robot = robot
        self._rates = rates
        self._command = [f"{joint}/{each}" for joint in joint_names for each in COMMAND_INTERFACES]
        self._states = [f"{joint}/{each}" for joint in joint_names for each in STATE_INTERFACES]
        self._requests = ThrottledLog(lambda text: node.get_logger().info(text))

        def serve(kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
            node.create_service(kind, f"{manager}/{name}", answer, qos_profile=REQUEST_QOS)

        try:
            serve(ListControllers, "list_controllers", self._list_controllers)
        except (RuntimeError, ValueError) as error:
            accepted = "a name such as controller_manager or /cell/controller_manager, or nothing for no such services"
            raise ConfigError(
                f"parameter controller_manager is {quoted(manager)}; accepted: {accepted}"
            ) from error
        serve(ListControllerTypes, "list_controller_types", self._list_types)
        serve(ListHardwareComponents, "list_hardware_components", self._list_components)
        serve(ListHardwareInterfaces, "list_hardware_interfaces", self._list_interfaces)
        serve(SwitchController, "switch_controller", self._switch)
        serve(SetHardwareComponentState, "set_hardware_component_state", self._set_component_state)
        for kind, name in (
            (LoadController, "load_controller"),
            (UnloadController, "unload_controller"),
            (ConfigureController, "configure_controller"),
            (CleanupController, "cleanup_controller"),
            (ReloadControllerLibraries, "reload_controller_libraries"),
        ):
            serve(kind, name, partial(self._refuse, name))

    # What there is.

    def _list_controllers(
        self, _: Any, response: ListControllers.Response
    ) -> ListControllers.Response:
        active = self._loop.state.switch.active
        state = ControllerState(
            name=self._name,
            state="active" if active else "inactive",
            type=TYPE,
            update_rate=self._rates[0],
            claimed_interfaces=self._command if active else [],
            required_command_interfaces=self._command,
            required_state_interfaces=self._states,
        )
        response.controller = [state]
        return response

    def _list_types(
        self, _: Any, response: ListControllerTypes.Response
    ) -> ListControllerTypes.Response:
        response.types = [TYPE]
        response.base_classes = [_BASE_CLASS]
        return response

    def _interfaces(self) -> tuple[list[HardwareInterface], list[HardwareInterface]]:
        """Return the command and the state interfaces; as in the original, only the former are ever claimed."""
        claimed = self._loop.state.switch.active

        def of(names: Sequence[str], claimed: bool) -> list[HardwareInterface]:
            return [
                HardwareInterface(
                    name=name, data_type="double", is_available=True, is_claimed=claimed
                )
                for name in names
            ]

        return of(self._command, claimed), of(self._states, False)

    def _list_interfaces(
        self, _: Any, response: ListHardwareInterfaces.Response
    ) -> ListHardwareInterfaces.Response:
        response.command_interfaces, response.state_interfaces = self._interfaces()
        return response

    def _list_components(
        self, _: Any, response: ListHardwareComponents.Response
    ) -> ListHardwareComponents.Response:
        command, states = self._interfaces()
        component = HardwareComponentState(
            name=self._robot,
            type=_COMPONENT_TYPE,
            rw_rate=self._rates[1],
            plugin_name=self._name,
            state=_ACTIVE,
            command_interfaces=command,
            state_interfaces=states,
        )
        response.component = [component]
        return response

    # What cannot be changed.

    def _switch(
        self, request: SwitchController.Request, response: SwitchController.Response
    ) -> Any:
        """Answer that all is as it should be already, or why it cannot be; strict requests are held to be changes."""
        activate = set(request.activate_controllers)
        deactivate = set(request.deactivate_controllers)
        active = {self._name} if self._loop.state.switch.active else set()
        idle = activate <= active and not deactivate & active
        unknown = sorted((activate | deactivate) - {self._name})
        strict = request.strictness == SwitchController.Request.STRICT
        response.ok = idle and not unknown and not (strict and (activate or deactivate))
        state = "active" if active else "inactive"
        if response.ok:
            response.message = f"nothing to switch: {self._name} is {state}"
        else:
            others = f"; unknown: {', '.join(map(quoted, unknown))}" if unknown else ""
            response.message = (
                f"{self._name} is {state}{others}; it {_FIXED}; accepted: {_ANOTHER_WAY}"
            )
            self._requests.say("switch_controller", f"switch_controller: {response.message}")
        return response

    def _set_component_state(
        self,
        request: SetHardwareComponentState.Request,
        response: SetHardwareComponentState.Response,
    ) -> Any:
        """Answer the state that the arm is in; no other can be reached."""
        target = request.target_state
        is_active = target.label == _ACTIVE.label if target.label else target.id == _ACTIVE.id
        response.ok = request.name == self._robot and is_active
        response.state = _ACTIVE
        if not response.ok:
            return self._refuse("set_hardware_component_state", request, response)
        return response

    def _refuse(self, name: str, _: Any, response: Any) -> Any:
        """Answer no, which has no room for a reason; the log has."""
        response.ok = False
        self._requests.say(name, f"{name}: {self._name} {_FIXED}; accepted: {_ANOTHER_WAY}")
        return response


_ACTIVE = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
