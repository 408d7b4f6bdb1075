"""Draw an arm in some poses, from the visual geometry of its URDF, by casting rays.

python -m tools.arm_picture                  # docs/images/arm.png
python -m tools.arm_picture --robot tx40 --output /tmp/tx40.png
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from rx90_common.base.errors import Rx90Error
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.description.shapes import visual_shapes

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "arm.png"
_POSES = (
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 1.5708, 0.0, 0.0, 0.0),
    (-0.464, 0.75, 1.449, 0.0, 0.943, -0.464),
    (2.2, -0.6, 1.9, 0.8, -0.9, 0.0),
)
_AZIMUTHS = (35.0, 90.0, -40.0, 30.0)  # of the eye about z, deg
_ELEVATION = 14.0  # deg
# right, away, up, as the eye sees it
_LIGHT = np.array([0.35, -0.5, 0.8]) / np.linalg.norm([0.35, -0.5, 0.8])
_SAMPLES = 3  # along each side of a pixel
_LENGTH = 400  # of the arm, in pixels

_Vectors = NDArray[np.float64]


class Solid(NamedTuple):
    """A box, cylinder or sphere: half its extent along its axes, m, its place, and its colour."""

    kind: str
    half: _Vectors
    rotation: _Vectors
    position: _Vectors
    color: _Vectors


def solids(robot: RobotModel, position: tuple[float, ...]) -> list[Solid]:
    """Return the visual geometry of an arm in a pose, rad."""
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, np.array(position))
    found = []
    for shape in visual_shapes(robot):
        place = data.oMi[shape.joint + 1] * pin.SE3(shape.rotation, shape.position)
        found.append(Solid(shape.kind, shape.half, place.rotation, place.translation, shape.color))
    return found


def cast(solid: Solid, origins: _Vectors, direction: _Vectors) -> tuple[_Vectors, _Vectors]:
    """Return where parallel rays enter a solid, in m along them and inf for a miss, and its normals there.

    Args:
        solid: the solid.
        origins: (n, 3) m.
        direction: (3,) of all rays, of length 1.
    """
    start, along = (origins - solid.position) @ solid.rotation, direction @ solid.rotation
    if solid.kind == "Box":
        near, far, normal = _slabs(start, along, solid.half, (0, 1, 2))
    else:
        round_axes = (0, 1) if solid.kind == "Cylinder" else (0, 1, 2)
        near, far, normal = _round(start, along, solid.half[0], round_axes)
        if solid.kind == "Cylinder":
            cap_near, cap_far, cap_normal = _slabs(start, along, solid.half, (2,))
            normal = np.where((cap_near > near)[:, None], cap_normal, normal)
            near, far = np.maximum(near, cap_near), np.minimum(far, cap_far)
    return np.where(near < far, near, np.inf), normal @ solid.rotation.T


def _slabs(
    start: _Vectors, along: _Vectors, half: _Vectors, axes: tuple[int, ...]
) -> tuple[_Vectors, _Vectors, _Vectors]:
    """Return where rays enter and leave the space between pairs of planes, and the normal where they enter."""
    near, far, normal = (
        np.full(len(start), -np.inf),
        np.full(len(start), np.inf),
        np.zeros_like(start),
    )
    for axis in axes:
        speed = along[axis] if abs(along[axis]) > 1e-12 else 1e-12
        enter = (-np.sign(speed) * half[axis] - start[:, axis]) / speed
        leave = (np.sign(speed) * half[axis] - start[:, axis]) / speed
        face = np.zeros(3)
        face[axis] = -np.sign(speed)
        normal = np.where((enter > near)[:, None], face, normal)
        near, far = np.maximum(near, enter), np.minimum(far, leave)
    return near, far, normal


def _round(
    start: _Vectors, along: _Vectors, radius: float, axes: tuple[int, ...]
) -> tuple[_Vectors, _Vectors, _Vectors]:
    """Return where rays enter and leave an endless cylinder or a sphere, and the normal where they enter."""
    place, speed = start[:, axes], along[list(axes)]
    square = max(float(speed @ speed), 1e-12)
    middle = place @ speed / square
    root = middle**2 - (np.einsum("ij,ij->i", place, place) - radius**2) / square
    reach = np.sqrt(np.maximum(root, 0.0))
    near = np.where(root > 0.0, -middle - reach, np.inf)
    normal = np.zeros_like(start)
    normal[:, axes] = (place + near[:, None].clip(-10.0, 10.0) * speed) / radius
    return near, np.where(root > 0.0, -middle + reach, -np.inf), normal


def view(
    shown: list[Solid], azimuth: float, center: _Vectors, size: tuple[float, float], pixels: int
) -> _Vectors:
    """Return a picture, (rows, columns, 3) from 0 to 1, on white, seen along parallel rays.

    Args:
        shown: what is to be seen.
        azimuth: of the eye about z, deg.
        center: the point in the middle, m.
        size: width and height, m.
        pixels: in each metre.
    """
    turn, tilt = np.deg2rad(azimuth), np.deg2rad(_ELEVATION)
    toward = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.cross(toward, right)
    light = _LIGHT @ np.array([right, -toward, up])
    columns, rows = (_SAMPLES * round(extent * pixels) for extent in size)
    across = (np.arange(columns) + 0.5) / (pixels * _SAMPLES) - size[0] / 2.0
    upward = size[1] / 2.0 - (np.arange(rows) + 0.5) / (pixels * _SAMPLES)
    origins = (
        (across[None, :, None] * right + upward[:, None, None] * up).reshape(-1, 3)
        + center
        + 5.0 * toward
    )
    nearest, color = np.full(len(origins), np.inf), np.ones((len(origins), 3))
    for solid in shown:
        offset = solid.position - center
        reach = float(np.linalg.norm(solid.half))
        window = (abs(across - offset @ right) < reach)[None, :] & (
            abs(upward - offset @ up) < reach
        )[:, None]
        seen = np.flatnonzero(window.ravel())
        depth, normal = cast(solid, origins[seen], -toward)
        ahead = depth < nearest[seen]
        seen, depth, normal = seen[ahead], depth[ahead], normal[ahead]
        nearest[seen] = depth
        brightness = 0.42 + 0.58 * np.clip(normal @ light, 0.0, 1.0)
        color[seen] = brightness[:, None] * solid.color
    picture = color.reshape(rows // _SAMPLES, _SAMPLES, columns // _SAMPLES, _SAMPLES, 3).mean(
        axis=(1, 3)
    )
    return np.asarray(picture)


def arm_picture(robot: RobotModel, pixels: int) -> _Vectors:
    """Return the arm in some poses, side by side, without empty margins.

    Args:
        robot: the arm.
        pixels: along its length when it is stretched out.
    """
    length = float(np.linalg.norm(robot.chain.origin, axis=1).sum())
    center, size = np.array([0.0, 0.0, 0.5 * length]), (1.8 * length, 1.5 * length)
    views = [
        view(solids(robot, position), azimuth, center, size, round(pixels / length))
        for position, azimuth in zip(_POSES, _AZIMUTHS, strict=True)
    ]
    margin = np.ones((views[0].shape[0], pixels // 10, 3))
    used = [picture[:, (picture < 1.0).any(axis=(0, 2))] for picture in views]
    together = np.concatenate(
        [part for picture in used for part in (margin, picture)] + [margin], axis=1
    )
    rows = np.flatnonzero((together < 1.0).any(axis=(1, 2)))
    return np.pad(together[rows[0] : rows[-1] + 1], ((8, 8), (0, 0), (0, 0)), constant_values=1.0)


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description="Draw an arm in some poses.")
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, help="name of a shipped robot, or a robot folder"
    )
    parser.add_argument("--output", type=Path, default=PICTURE, help="PNG file")
    options = parser.parse_args()
    import matplotlib.image

    try:
        files = RobotFiles.named(options.robot)
        picture = arm_picture(load_robot(files.urdf, files.tool), _LENGTH)
    except Rx90Error as error:
        parser.exit(error.exit_code, f"arm_picture: {error}\n")
    matplotlib.image.imsave(options.output, picture)
    print(options.output)


if __name__ == "__main__":
    main()
