"""The former names of `sanity`, for the fit of sweeps."""

from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions
from rx90_emulator.identification.sanity import Recorded, mistake_alarms

__all__ = ["Recorded", "suspicion"]


def suspicion(
    arm: RigidArm, recorded: Recorded, options: RobotOptions = SHIPPED_ROBOT, zero: Array | None = None
) -> tuple[dict[int, str], str]:
    """Return nothing, and in words what looks wrong."""
    return {}, "; ".join(mistake_alarms(arm, recorded, options, zero))
