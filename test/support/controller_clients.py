"""Clients that look for controllers, call by call as their sources do; to be imported where their types are.

rqt_joint_trajectory_controller: ros2_controllers 94e74de, joint_trajectory_controller.py and utils.py.
MoveIt's Ros2ControlManager and Ros2ControlMultiManager: moveit2 4d84106, controller_manager_plugin.cpp.
"""

from typing import Any

from controller_manager_msgs.srv import ListControllers
from ros_client import Client

CM_SERVICES = {
    "list_controllers": "controller_manager_msgs/srv/ListControllers",
    "list_controller_types": "controller_manager_msgs/srv/ListControllerTypes",
    "load_controller": "controller_manager_msgs/srv/LoadController",
    "unload_controller": "controller_manager_msgs/srv/UnloadController",
    "switch_controller": "controller_manager_msgs/srv/SwitchController",
    "reload_controller_libraries": "controller_manager_msgs/srv/ReloadControllerLibraries",
}


class Rqt:
    def __init__(self, client: Client) -> None:
        self._client = client

    def managers(self) -> list[str]:
        services = self._client.node.get_service_names_and_types()
        sloppy = [name.split("/list_controllers")[0] or "/" for name, _ in services if "/list_controllers" in name]
        return sorted(space for space in sloppy if self._is_manager(space))

    def _is_manager(self, space: str) -> bool:
        types = dict(self._client.node.get_service_names_and_types())
        space = space if space.endswith("/") else f"{space}/"
        return all(
            f"{space}{name}" in types and types[f"{space}{name}"][0] == kind for name, kind in CM_SERVICES.items()
        )

    def running(self, manager: str) -> list[Any]:
        answer = self._client.asking.call(ListControllers, f"{manager}/list_controllers", ListControllers.Request())
        found = [each for each in answer.controller if "JointTrajectoryController" in each.type]
        return [each for each in found if each.state == "active"]

    @staticmethod
    def joint_names(controller: Any) -> list[str]:
        names: list[str] = []
        for interface in controller.required_state_interfaces:
            name, kind = "/".join(interface.split("/")[:-1]), interface.split("/")[-1]
            if name not in names and kind == "position":
                names.append(name)
        return names


class MoveIt:
    HANDLED = ("joint_trajectory_controller/JointTrajectoryController",)  # of moveit_ros_control_interface_plugins.xml

    def __init__(self, client: Client) -> None:
        self._client = client
        self.managed: dict[str, Any] = {}
        self.active: dict[str, Any] = {}
        self.discover()

    @staticmethod
    def namespaces(client: Client) -> list[str]:
        names = [name for name, _ in client.node.get_service_names_and_types()]
        service = "controller_manager/list_controllers"
        return [name.partition(service)[0] for name in names if service in name]

    def discover(self) -> None:
        request = ListControllers.Request()
        answer = self._client.asking.call(ListControllers, "/controller_manager/list_controllers", request)
        self.managed, self.active = {}, {}
        for controller in answer.controller:
            assert not controller.chain_connections
            if controller.state == "active":
                self.active[controller.name] = [each.split("/")[0] for each in controller.claimed_interfaces]
            if controller.type in self.HANDLED:
                self.managed[f"/{controller.name}"] = controller
