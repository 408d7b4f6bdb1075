"""The pictures of the arm in the documentation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from rx90_emulator.loop.setup import Setup
from tools.arm_picture import arm_picture, solids

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


def test_the_arm_is_seen_with_all_its_shapes(shipped: Setup) -> None:
    """Every visual shape of URDF and tool is drawn, and the picture of the poses has no empty margin."""
    assert len(solids(shipped.robot, (0.0,) * 6)) == shipped.robot.urdf.count("<visual>")
    picture = arm_picture(shipped.robot, 40)
    assert (picture[8] < 1.0).any()
    assert (picture[-9] < 1.0).any()
