"""The torque that an elastic gear with play transmits, as its mean over a step.

A spring and a damper lie between the motor, seen through its gear, and what it moves. The twist t is by how much the
motor is ahead. Without play

    torque = k t + d dt/dt.

With play of the width 2 b they push where the flanks touch, and never pull:

    torque = max(0, k (t - b) + d dt/dt)   where t > b,   min(0, k (t + b) + d dt/dt)   where t < -b,   else 0

(the dead-zone model of Nordin and Gutman 2002, "Controlling mechanical systems with backlash - a survey", Automatica
38, with the damper in contact alone). A step takes the mean of this torque along the way of the twist, at its mean
rate. For the spring that is the difference of its energy over the way, a discrete gradient (Gonzalez 1996, "Time
integration and discrete Hamiltonian systems", Journal of Nonlinear Science 6): whatever the step, it gives back what
was put into it, also where flanks meet or part within the step.
"""

from __future__ import annotations

import numpy as np

from rx90_common.kernels.compiled import kernel

TRANSMISSION_DTYPE = np.dtype(
    [
        ("flexible", np.int64),  # whether any drive is elastic; if not, nothing below is used
        ("link_friction", np.int64),  # whether the friction of the joints acts on the links
        ("elastic", np.int64, 6),
        ("rotor", np.float64, 6),  # joint side, kg m^2
        ("stiffness", np.float64, 6),  # 0 for rigid drives
        ("damping", np.float64, 6),
        ("half_play", np.float64, 6),
    ],
    align=True,
)
"""Constants; drive 6 moves q5 + q6."""

TRANSMISSION_STATE_DTYPE = np.dtype(
    [
        ("twist", np.float64, 6),  # of the motor, seen through the gear, beyond what it moves, rad
        ("rate", np.float64, 6),
        ("torque", np.float64, 6),  # mean over the last step, Nm
        ("friction", np.float64, 6),  # on the motors, brakes and cogging included, mean over the last step, Nm
        ("link_torque", np.float64, 6),  # on the links, but for the transmitted one, in the last step, Nm
        # Workspace of a step.
        ("acceleration", np.float64, 6),  # of the twist
        ("twist_mid", np.float64, 6),
        ("rate_mid", np.float64, 6),
        ("motor_angle", np.float64, 6),  # of the joints as the motors have them, rad
        ("motor_velocity", np.float64, 6),
        ("drive", np.float64, 6),  # torque of the motors less friction, Nm
        ("offset", np.float64, 6),  # torque = offset + slope acceleration
        ("slope", np.float64, 6),
        ("matrix", np.float64, (6, 6)),
    ],
    align=True,
)


@kernel
def mean_torque(
    stiffness: float, damping: float, half_play: float, twist: float, way: float, step: float
) -> tuple[float, float]:
    """Return the mean torque, Nm, over a step in which the twist goes on by `way`, and its derivative by `way`.

    Args:
        stiffness: Nm/rad, > 0.
        damping: Nm s/rad.
        half_play: b, rad; 0 for none.
        twist: at the start of the step, rad.
        way: rad.
        step: s.
    """
    if half_play == 0.0:
        return stiffness * (twist + 0.5 * way) + damping * way / step, 0.5 * stiffness + damping / step
    ahead, ahead_slope = _push(stiffness, damping, twist - half_play, way, step)
    behind, behind_slope = _push(stiffness, damping, -twist - half_play, -way, step)
    return ahead - behind, ahead_slope + behind_slope


@kernel
def _push(stiffness: float, damping: float, depth: float, way: float, step: float) -> tuple[float, float]:
    """Return what one flank pushes, and the derivative, for a depth of contact that goes on by `way`."""
    damper, drag = damping * way / step, damping / step
    if way < 0.0:
        # The flank pushes no more as soon as the damper would pull as much as the spring pushes.
        depth += damper / stiffness
        damper = 0.0
    end = depth + way
    if depth <= 0.0 and end <= 0.0:
        return 0.0, 0.0
    if depth >= 0.0 and end >= 0.0:
        return 0.5 * stiffness * (depth + end) + damper, 0.5 * stiffness + drag
    if way > 0.0:
        share = end / way  # of the way, in contact
        return share * (0.5 * stiffness * end + damper), stiffness * share * (1.0 - 0.5 * share) + drag
    share = -depth / way
    return share * 0.5 * stiffness * depth, share * (0.5 * stiffness * share + drag)


@kernel
def twist_at_rest(stiffness: float, half_play: float, torque: float) -> float:
    """Return the twist, rad, that transmits a torque, Nm, at rest; the middle of the play for none."""
    twist = torque / stiffness
    if torque > 0.0:
        twist += half_play
    elif torque < 0.0:
        twist -= half_play
    return twist
