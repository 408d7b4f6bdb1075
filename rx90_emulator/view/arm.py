"""An arm in the scene, drawn from the shapes of its URDF and tool."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import viser
from viser import transforms

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RobotModel
from rx90_common.description.shapes import VisualShape, drawn_shapes
from rx90_emulator.view.page import Page

_GHOST_OPACITY = 0.3


class ArmScene:
    """An arm, each joint's frame a node below that of the joint before it; `tip` is the name of the last node.

    Args:
        page: to draw in.
        name: of its node in the scene, such as "/arm".
        robot: the arm with its tool.
        ghost: transparent, for a second arm beside or in the first.
        tint: colour of a ghost, red, green and blue, 0 to 255; None: its own colours.
    """

    def __init__(
        self,
        page: Page,
        name: str,
        robot: RobotModel,
        *,
        ghost: bool = False,
        tint: tuple[int, int, int] | None = None,
    ) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        shapes = drawn_shapes(robot)
        opacity = _GHOST_OPACITY if ghost else None
        self._root = page.scene.add_frame(name, show_axes=False)
        self._joints: list[viser.FrameHandle] = []
        path = name
        self._draw(page.scene, path, [shape for shape in shapes if shape.joint < 0], opacity, tint)
        for index, joint in enumerate(robot.joint_names):
            path = f"{path}/{joint}"
            self._joints.append(page.scene.add_frame(path, show_axes=False))
            self._draw(page.scene, path, [shape for shape in shapes if shape.joint == index], opacity, tint)
        frame = robot.model.frames[robot.model.getFrameId(robot.tcp_frame)].placement
        self.tip = f"{path}/tip"
        page.scene.add_frame(
            self.tip, show_axes=False, position=frame.translation, wxyz=_quaternion(frame.rotation)
        )  # fmt: skip
        self.show(np.zeros(len(robot.joint_names)))

    def show(self, position: Array) -> None:
        """Show the arm with its joints at `position`, (6,) rad."""
        pin.forwardKinematics(self._model, self._data, np.asarray(position, dtype=np.float64))
        for handle, place in zip(self._joints, list(self._data.liMi)[1:], strict=True):
            handle.wxyz = _quaternion(place.rotation)
            if not np.array_equal(handle.position, place.translation):
                handle.position = place.translation

    @property
    def visible(self) -> bool:
        """Whether it is drawn."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, shown: bool) -> None:
        self._root.visible = shown

    @staticmethod
    def _draw(
        scene: viser.SceneApi,
        path: str,
        shapes: list[VisualShape],
        opacity: float | None,
        tint: tuple[int, int, int] | None,
    ) -> None:
        for number, shape in enumerate(shapes):
            red, green, blue = tint or (round(255 * part) for part in shape.color.tolist())
            name, color = f"{path}/shape_{number}", (red, green, blue)
            solid, center, axes = opacity is None, shape.position, _quaternion(shape.rotation)
            size = 2.0 * shape.half
            if shape.kind == "Box":
                scene.add_box(name, color, size, opacity=opacity, cast_shadow=solid, position=center, wxyz=axes)
            elif shape.kind == "Cylinder":
                scene.add_cylinder(
                    name, size[0] / 2.0, size[2], color,
                    opacity=opacity, cast_shadow=solid, position=center, wxyz=axes,
                )  # fmt: skip
            else:
                scene.add_icosphere(name, size[0] / 2.0, color, opacity=opacity, cast_shadow=solid, position=center)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,), scalar first, of a rotation (3, 3)."""
    return np.asarray(transforms.SO3.from_matrix(np.asarray(rotation)).wxyz)
