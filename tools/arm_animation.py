"""Draw the arm along its reference line as a short animation, from the visual geometry of its URDF.

python -m tools.arm_animation                  # docs/images/arm.webp
python -m tools.arm_animation --robot tx40 --output /tmp/tx40.webp
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import rx90_emulator as rx
from rx90_common.base.errors import Rx90Error
from rx90_common.description.robot_files import DEFAULT_ROBOT
from tools.arm_picture import Solid, solids, view

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "arm.webp"
_FRAMES_PER_SECOND = 12
_PIXELS = 370  # in each metre
_SIZE = (1.35, 1.05)  # m
_AZIMUTH = 55.0  # of the eye about z, deg
_GREY, _RED = np.array([0.55, 0.55, 0.58]), np.array([0.85, 0.1, 0.1])
_THIN, _THICK = 0.004, 0.008  # m
_LARGEST = 400_000  # bytes

_Vector = NDArray[np.float64]


def rod(start: _Vector, end: _Vector, radius: float, color: _Vector) -> Solid:
    """Return a thin cylinder between two points, m."""
    length = float(np.linalg.norm(end - start))
    rotation = pin.Quaternion.FromTwoVectors(
        np.array([0.0, 0.0, 1.0]), end - start
    ).toRotationMatrix()
    return Solid(
        "Cylinder", np.array([radius, radius, 0.5 * length]), rotation, 0.5 * (start + end), color
    )


def frame(setup: rx.Setup, task: rx.LineTask, position: tuple[float, ...]) -> NDArray[np.uint8]:
    """Return a picture, (rows, columns, 3), of the arm in a pose, rad, with line, laser beam and what it has drawn."""
    model = setup.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(position))
    tool, spot = (data.oMf[model.getFrameId(name)].translation for name in ("flange", "tcp"))
    start, end = np.array(task.start), np.array(task.end)
    shown = [
        *solids(setup.robot, position),
        rod(start, end, _THIN, _GREY),
        rod(tool, spot, _THIN, _RED),
    ]
    if (spot - start) @ (end - start) > 0.0:
        shown.append(rod(start, spot, _THICK, _RED))
    center = np.array([0.3, 0.0, 0.45])
    return np.asarray(255.0 * view(shown, _AZIMUTH, center, _SIZE, _PIXELS), dtype=np.uint8)


def frames(robot: str) -> list[Image.Image]:
    """Return the pictures of one run of the closed loop without ROS along the reference line of a robot."""
    setup, task = rx.load_setup(robot=robot), rx.load_task(robot=robot)
    run = rx.run_line(setup, task)
    joints, path = run.series["joint_states"], run.path_accuracy
    font = ImageFont.load_default(18)
    pictures = []
    for time in np.arange(0.5, joints.time[-1], 1.0 / _FRAMES_PER_SECOND):
        sample = int(np.searchsorted(joints.time, time))
        picture = Image.fromarray(frame(setup, task, tuple(joints.position[sample])))
        error = float(np.interp(time, path.times, path.perpendicular, left=0.0, right=0.0))
        ImageDraw.Draw(picture).text(
            (12, 10),
            f"{time:3.1f} s    off the line: {error * 1e3:.3f} mm",
            font=font,
            fill=(60, 60, 60),
        )
        pictures.append(picture)
    return pictures


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description="Draw an arm along its reference line, animated.")
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, help="name of a shipped robot, or a robot folder"
    )
    parser.add_argument("--output", type=Path, default=PICTURE, help="WebP file")
    options = parser.parse_args()
    try:
        first, *others = frames(options.robot)
    except Rx90Error as error:
        parser.exit(error.exit_code, f"arm_animation: {error}\n")
    first.save(
        options.output, save_all=True, append_images=others, duration=round(1000 / _FRAMES_PER_SECOND), loop=0,
        quality=60, method=6,
    )  # fmt: skip
    size = options.output.stat().st_size
    print(f"{options.output}: {1 + len(others)} pictures, {size / 1e3:.0f} kB")
    if size > _LARGEST:
        parser.exit(1, f"arm_animation: larger than {_LARGEST / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
