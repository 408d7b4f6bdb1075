"""The pictures of the arm in the documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rx90_emulator as rx
from rx90_emulator.loop.setup import Setup
from tools import arm_animation
from tools.arm_picture import Solid, arm_picture, solids, view

WEBP = Path(__file__).resolve().parents[2] / "docs/images/arm.webp"


def test_the_animation_is_small_and_moves() -> None:
    """It has at least 40 pictures, less than 400 kB, and the arm is elsewhere in the last than in the first."""
    assert WEBP.stat().st_size < 400_000
    with Image.open(WEBP) as animation:
        assert getattr(animation, "n_frames", 1) >= 40
        first = np.asarray(animation.convert("L"), dtype=float)
        animation.seek(animation.n_frames - 1)
        last = np.asarray(animation.convert("L"), dtype=float)
    assert np.mean(np.abs(last - first) > 30.0) > 0.01


def test_the_trace_ends_at_the_spot(shipped: rx.Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the end of the line the picture is red along all of it, at the start nowhere there."""
    monkeypatch.setattr(arm_animation, "_PIXELS", 120)
    task = rx.load_task()
    plan = rx.plan_line(shipped, task)
    start, end = (arm_animation.frame(shipped, task, tuple(plan.position[k])) for k in (0, -1))

    def red(picture: np.ndarray) -> int:
        channels = picture.astype(int)
        return int(((channels[..., 0] > 100) & (channels[..., 1] < 60) & (channels[..., 2] < 60)).sum())

    assert red(end) > red(start) + 30


PIXELS = 200  # in each metre
TURNED = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # its z along -y
TILT = np.deg2rad(14.0)  # of the eye


def area(solid: Solid) -> float:
    """Return the area that a solid covers, m^2, seen along -x."""
    picture = view([solid], 0.0, np.zeros(3), (1.0, 1.0), PIXELS)
    return float((1.0 - (picture == 1.0).all(axis=2)).sum()) / PIXELS**2


@pytest.mark.parametrize(
    ("kind", "half", "rotation", "expected"),
    [
        ("Sphere", (0.2, 0.2, 0.2), np.eye(3), np.pi * 0.2**2),
        # From the side a rectangle; on it half of the top's ellipse and half of the bottom's.
        ("Cylinder", (0.2, 0.2, 0.3), np.eye(3), 0.4 * 0.6 * np.cos(TILT) + np.pi * 0.2**2 * np.sin(TILT)),
        ("Cylinder", (0.2, 0.2, 0.3), TURNED, 0.4 * 0.6),
        ("Box", (0.1, 0.2, 0.3), np.eye(3), 0.4 * (0.6 * np.cos(TILT) + 0.2 * np.sin(TILT))),
    ],
)
def test_solids_cover_what_they_should(
    kind: str, half: tuple[float, ...], rotation: np.ndarray, expected: float
) -> None:
    """The area that a sphere, cylinder or box covers is that of its parallel projection, to the width of a pixel."""
    solid = Solid(kind, np.array(half), rotation, np.zeros(3), np.array([0.5, 0.5, 0.5]))
    assert area(solid) == pytest.approx(expected, abs=2.5 / PIXELS)


def test_what_is_nearer_hides_what_is_behind() -> None:
    """A sphere in front of a box is seen, in its own colour, whichever of the two is drawn first."""
    red, blue = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    sphere = Solid("Sphere", np.full(3, 0.1), np.eye(3), np.array([0.5, 0.0, 0.0]), red)
    box = Solid("Box", np.array([0.1, 0.4, 0.4]), np.eye(3), np.zeros(3), blue)
    one, other = (view(shown, 0.0, np.zeros(3), (0.5, 0.5), 40) for shown in ([sphere, box], [box, sphere]))
    np.testing.assert_array_equal(one, other)
    at = int(10 + 0.5 * np.sin(TILT) * 40)  # seen from above it is lower
    assert one[at, 10, 0] > 0.3 > one[at, 10, 2]
    assert one[3, 3, 2] > 0.3 > one[3, 3, 0]


def test_the_arm_is_seen_with_all_its_shapes(shipped: Setup) -> None:
    """Every visual shape of URDF and tool is drawn, and the picture of the poses has no empty margin."""
    assert len(solids(shipped.robot, (0.0,) * 6)) == shipped.robot.urdf.count("<visual>")
    picture = arm_picture(shipped.robot, 40)
    assert (picture[8] < 1.0).any()
    assert (picture[-9] < 1.0).any()
