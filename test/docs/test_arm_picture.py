"""The pictures of the arm in the documentation."""

from __future__ import annotations

from rx90_emulator.loop.setup import Setup
from tools.arm_picture import arm_picture, solids


def test_the_arm_is_seen_with_all_its_shapes(shipped: Setup) -> None:
    """Every visual shape of URDF and tool is drawn, and the picture of the poses has no empty margin."""
    assert len(solids(shipped.robot, (0.0,) * 6)) == shipped.robot.urdf.count("<visual>")
    picture = arm_picture(shipped.robot, 40)
    assert (picture[8] < 1.0).any()
    assert (picture[-9] < 1.0).any()
