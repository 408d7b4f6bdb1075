"""An arm in the scene, drawn from the shapes of its URDF and tool."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
import viser
from viser import transforms

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RobotModel
from rx90_common.description.shapes import VisualShape, drawn_shapes
from rx90_emulator.view.page import Page

# Of round shapes; a wire frame of few lines lets the arm behind it be seen.
_SEGMENTS, _GHOST_SEGMENTS = 32, 12
_SUBDIVISIONS, _GHOST_SUBDIVISIONS = 3, 1

Color: TypeAlias = tuple[int, int, int]


class ArmScene:
    """An arm, each joint's frame a node below that of the joint before it; `tip` is the name of the last node.

    Args:
        page: to draw in.
        name: of its node in the scene, such as "/arm".
        robot: the arm with its tool.
        ghost: colour of a wire frame, red, green and blue, 0 to 255, for a second arm beside or in the first, whose
            colours it leaves as they are; None: solid, in the shapes' own colours.
    """

    def __init__(self, page: Page, name: str, robot: RobotModel, *, ghost: Color | None = None) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        shapes = drawn_shapes(robot)
        self._root = page.scene.add_frame(name, show_axes=False)
        self._joints: list[viser.FrameHandle] = []
        path = name
        self._draw(page.scene, path, [shape for shape in shapes if shape.joint < 0], ghost)
        for index, joint in enumerate(robot.joint_names):
            path = f"{path}/{joint}"
            self._joints.append(page.scene.add_frame(path, show_axes=False))
            self._draw(page.scene, path, [shape for shape in shapes if shape.joint == index], ghost)
        self._tcp = robot.model.getFrameId(robot.tcp_frame)
        frame = robot.model.frames[self._tcp].placement
        self.tip = f"{path}/tip"
        page.scene.add_frame(
            self.tip, show_axes=False, position=frame.translation, wxyz=_quaternion(frame.rotation)
        )  # fmt: skip
        self.show(np.zeros(len(robot.joint_names)))

    def show(self, position: Array) -> Array:
        """Show the arm with its joints at `position`, (6,) rad; return where its tip is, (3,) m, in the arm's base."""
        pin.forwardKinematics(self._model, self._data, np.asarray(position, dtype=np.float64))
        for handle, place in zip(self._joints, list(self._data.liMi)[1:], strict=True):
            handle.wxyz = _quaternion(place.rotation)
            if not np.array_equal(handle.position, place.translation):
                handle.position = place.translation
        return np.array(pin.updateFramePlacement(self._model, self._data, self._tcp).translation)

    @property
    def visible(self) -> bool:
        """Whether it is drawn."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._root.visible = shown

    @staticmethod
    def _draw(scene: viser.SceneApi, path: str, shapes: list[VisualShape], ghost: Color | None) -> None:
        for number, shape in enumerate(shapes):
            red, green, blue = ghost or (round(255 * part) for part in shape.color.tolist())
            name, color, size = f"{path}/shape_{number}", (red, green, blue), 2.0 * shape.half
            look: dict[str, Any] = {"wireframe": ghost is not None, "cast_shadow": ghost is None}
            place: dict[str, Any] = {"position": shape.position, "wxyz": _quaternion(shape.rotation)}
            if shape.kind == "Box":
                scene.add_box(name, color, size, **look, **place)
            elif shape.kind == "Cylinder":
                segments = _SEGMENTS if ghost is None else _GHOST_SEGMENTS
                scene.add_cylinder(name, size[0] / 2.0, size[2], color, radial_segments=segments, **look, **place)
            else:
                subdivisions = _SUBDIVISIONS if ghost is None else _GHOST_SUBDIVISIONS
                scene.add_icosphere(name, size[0] / 2.0, color, subdivisions=subdivisions, **look, **place)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,), scalar first, of a rotation (3, 3)."""
    return np.asarray(transforms.SO3.from_matrix(np.asarray(rotation)).wxyz)
