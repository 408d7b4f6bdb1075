"""The arm on its line as an animated drawing, in parallel projection.

The drawing is in points of a picture whose y axis points down. `templates/animation.js` moves it.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.colors import to_hex
from scipy.spatial import ConvexHull

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import decompose, tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.description.shapes import VisualShape, drawn_shapes
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.line import PathAccuracy

WIDTH, HEIGHT = 720.0, 460.0
"""Of the picture, in its points."""
_MARGIN = 16.0
_MOST_FRAMES = 400
_FRAME_RATE = 50.0  # Hz
_ELEVATION = math.radians(20.0)  # of the eye
_AZIMUTH = math.radians(-50.0)  # from the normal of the line
# share of the picture's height that the largest deviation is drawn as, at most
_MAX_DEVIATION_SHARE = 0.12
_CIRCLE_CORNERS = 20  # of what stands for a circle


@dataclass(frozen=True, eq=False)
class Animation:
    """What the animation shows.

    Attributes:
        times: s since the motion along the line began, shape (n,).
        along: distance along the line, m, shape (n,).
        error: distance from the line, m, shape (n,).
        views: from the frame of each joint, and last of the base, to the picture's right, up and towards the eye in
            points, shape (n, 7, 3, 4).
        shapes: which of these frames each shape moves with, and its corners in it, m, shape (k, 3).
        colours: of the shapes.
        line: ends of the line in the picture, shape (2, 2).
        trail: tip in the picture, its deviation from the line enlarged, shape (n, 2).
        enlarged: how many times.
    """

    times: Array
    along: Array
    error: Array
    views: Array
    shapes: list[tuple[int, Array]]
    colours: list[str]
    line: Array
    trail: Array
    enlarged: float

    @property
    def still(self) -> int:
        """Return the frame that is shown first, and printed: the one with the largest error."""
        return int(self.error.argmax())

    def outlines(self, frame: int) -> list[tuple[int, str]]:
        """Return the shapes from back to front, each with its outline as the points of an SVG polygon."""
        seen = [
            corners @ self.views[frame, k, :, :3].T + self.views[frame, k, :, 3]
            for k, corners in self.shapes
        ]
        found = []
        for which in np.argsort(
            [float(points[:, 2].mean()) for points in seen], kind="stable"
        ).tolist():
            flat = seen[which][:, :2] * (1.0, -1.0)
            found.append((which, _points(flat[ConvexHull(flat).vertices])))
        return found

    @property
    def data(self) -> str:
        """Return what the script needs, as JSON for a <script> element."""
        content: dict[str, Any] = {
            "times": np.round(self.times, 4).tolist(),
            "along": np.round(self.along * 1e3, 3).tolist(),
            "error": np.round(self.error * 1e3, 6).tolist(),
            "views": base64.b64encode(self.views.astype("<f4").tobytes()).decode("ascii"),
            "shapes": [
                {"frame": k, "corners": np.round(corners, 5).tolist()} for k, corners in self.shapes
            ],
            "trail": np.round(self.trail, 2).tolist(),
            "still": self.still,
        }
        return json.dumps(content, allow_nan=False, separators=(",", ":"))

    @property
    def trail_points(self) -> str:
        """Return the trail up to the still frame as the points of an SVG polyline."""
        return _points(self.trail[: self.still + 1])

    def chart(self, width: float, height: float, limit: float) -> str:
        """Return error over distance as the points of a polyline as high as the larger of largest error and limit."""
        top = max(float(self.error.max()), limit)
        return _points(
            np.column_stack(
                [width * self.along / self.along.max(), height * (1.0 - self.error / top)]
            )
        )


def animate(
    joints: JointSeries, path: PathAccuracy, robot: RobotModel, task: LineTask
) -> Animation:
    """Return the animation of a run, of which `path` is the error, seen from the side of its line."""
    first, last = path.times[[0, -1]]
    step = max(1.0 / _FRAME_RATE, (last - first) / _MOST_FRAMES)
    wanted = np.arange(first, last + 0.5 * step, step)
    places = np.searchsorted(path.times, wanted - 1e-9).clip(max=len(path.times) - 1)
    frames = np.unique([*places, path.perpendicular.argmax()])
    rows = np.searchsorted(joints.time, path.times[frames] - 1e-9)
    position = joints.fields["position"][rows]
    poses = _poses(robot, position)
    tips = tip_position(robot.chain, position)
    shapes = drawn_shapes(robot)
    corners = [(shape.joint, _corners(shape)) for shape in shapes]
    ends = np.array([task.start, task.end])
    _, deviation = decompose(tips - ends[0], ends[1] - ends[0])
    eye = _eye(ends)
    solid = [
        (poses[:, k, :, :3] @ points.T + poses[:, k, :, 3:]).transpose(0, 2, 1)
        for k, points in corners
    ]
    flat = np.concatenate([points.reshape(-1, 3) for points in (*solid, ends)]) @ eye[:2].T
    low = flat.min(axis=0)
    high = flat.max(axis=0)
    scale = float(
        min((WIDTH - 2 * _MARGIN) / (high[0] - low[0]), (HEIGHT - 2 * _MARGIN) / (high[1] - low[1]))
    )
    shift = np.array(
        [0.5 * WIDTH - 0.5 * scale * (low[0] + high[0]), _MARGIN - scale * low[1] - HEIGHT, 0.0]
    )
    views = scale * np.einsum("ij,nkjl->nkil", eye, poses)
    views[..., 3] += shift
    # The largest of 1, 2, 5, 10, 20, ... with which the largest deviation has its share of the picture at most.
    most = max(_MAX_DEVIATION_SHARE * HEIGHT / scale / max(float(path.worst), 1e-9), 1.0)
    decade = 10.0 ** math.floor(math.log10(most))
    factor = max(decade * step for step in (1.0, 2.0, 5.0) if decade * step <= most)
    line = (scale * ends @ eye[:2].T + shift[:2]) * (1.0, -1.0)
    trail = (scale * (tips + (factor - 1.0) * deviation) @ eye[:2].T + shift[:2]) * (1.0, -1.0)
    colours = [
        to_hex((red, green, blue))
        for red, green, blue in (shape.color.tolist() for shape in shapes)
    ]
    error = path.perpendicular[frames]
    return Animation(
        path.times[frames] - first,
        path.along[frames],
        error,
        views,
        corners,
        colours,
        line,
        trail,
        factor,
    )


def _poses(robot: RobotModel, position: Array) -> Array:
    """Return the frames of joints and, last, of the base, (n, 7, 3, 4), m."""
    data = robot.model.createData()
    poses = np.zeros((len(position), len(robot.joint_names) + 1, 3, 4))
    poses[:, -1, :, :3] = np.eye(3)
    for n, angles in enumerate(position):
        pin.forwardKinematics(robot.model, data, angles)
        poses[n, :-1] = [placement.homogeneous[:3] for placement in list(data.oMi)[1:]]
    return poses


def _eye(ends: Array) -> Array:
    """Return the directions right, up and towards the eye as rows; the eye looks at the line from the front, aslant."""
    along = ends[1] - ends[0]
    middle = ends.mean(axis=0)
    turn = math.atan2(along[1], along[0]) + 0.5 * math.pi if np.hypot(*along[:2]) > 1e-6 else 0.0
    if middle[0] * math.cos(turn) + middle[1] * math.sin(turn) < 0.0:
        turn += math.pi
    beside = np.array([math.cos(turn + _AZIMUTH), math.sin(turn + _AZIMUTH), 0.0])
    toward = math.cos(_ELEVATION) * beside + np.array([0.0, 0.0, math.sin(_ELEVATION)])
    right = np.array([-beside[1], beside[0], 0.0])
    return np.array([right, np.cross(toward, right), toward])


def _corners(shape: VisualShape) -> Array:
    """Return points whose hull is the shape, in the frame that it moves with, m, shape (k, 3)."""
    turns = np.linspace(0.0, 2.0 * math.pi, _CIRCLE_CORNERS, endpoint=False)
    heights = np.linspace(-1.0, 1.0, 9 if shape.kind == "Sphere" else 2)
    if shape.kind == "Box":
        unit = np.array(list(product(heights, repeat=3)))
    else:
        z, turn = (each.ravel() for each in np.meshgrid(heights, turns, indexing="ij"))
        radius = np.sqrt(1.0 - z * z) if shape.kind == "Sphere" else 1.0
        unit = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
    return np.asarray((unit * shape.half) @ shape.rotation.T + shape.position)


def _points(points: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
