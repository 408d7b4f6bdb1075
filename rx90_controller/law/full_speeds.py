"""What 100 % of the speeds and accelerations of V+ programs is, and where its joints have their zero."""

from __future__ import annotations

from typing import Annotated

from rx90_common.base.models import FileModel, Positive, Row, RowOf, quantity


class FullSpeeds(FileModel):
    """Full speeds of V+ programs."""

    joint_speed: Annotated[RowOf[Positive], quantity("deg/s", "Of each joint.")]
    joint_acceleration: Annotated[RowOf[Positive], quantity("deg/s^2", "Of each joint.")]
    linear_speed: Annotated[float, quantity("mm/s", "Of the tool along a line.", gt=0.0)]
    linear_acceleration: Annotated[float, quantity("mm/s^2", "Likewise.", gt=0.0)]
    rotary_speed: Annotated[float, quantity("deg/s", "Of the tool's turn along a line.", gt=0.0)]
    rotary_acceleration: Annotated[float, quantity("deg/s^2", "Likewise.", gt=0.0)]
    zero: Annotated[Row, quantity("deg", "Joint values of V+ where the URDF's are 0.")]
    ready: Annotated[Row, quantity("deg", "Joint values of READY.")]
    null_tolerance: Annotated[
        float, quantity("deg", "Position error at which a motion is over, with FINE 100.", gt=0.0)
    ]
