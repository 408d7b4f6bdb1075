"""Generalised Maxwell slip: parallel blocks on springs, each of which sticks or slips; the memory is not local.

Lampaert, Al-Bender, Swevers, "A generalized Maxwell-slip friction model appropriate for control purposes", IEEE Physics
and Control (2003). Block i carries the part k_i of the stiffness c0 and the part a_i of the sliding torque
T(v) = c0 g(v), equation 19; both add up to 1. With its deflection z_i, torque F_i = k_i c0 z_i, and v > 0 (mirrored
below 0):

    sticking: dz_i/dt = v until F_i = a_i T(v), then it slips,
    slipping: dF_i/dt = C (a_i - F_i / T(v)), but dz_i/dt <= v; it sticks again when the velocity turns round,
    tau_f = sum of F_i + c1(v) sum of k_i dz_i/dt + viscous torque.

C is the attraction, Nm/s: after a change of velocity the torque comes to the sliding curve at the rate C / T(v). The
damping c1 is shared by the blocks as the stiffness is.

The bound dz_i/dt <= v is not in the paper. Without it a slipping block whose torque lags behind a rising T(v), as while
a joint comes to rest, would be loaded by the attraction faster than the joint moves: it would slip backwards, against
its friction, and create energy. With it such a block sticks. If the attraction requires no more than v, the
equations are the paper's; at v = 0 no block moves, to the last bit, and no sticking joint creeps.

**The step is exact for a constant velocity.** Let r_i = a_i g / k_i be the block's deflection in steady sliding, and
C / T the rate, common to all blocks. A block sticks until its deflection is r_i, or, if it slips already, until it is
r_i - |v| T / C, where the attraction requires exactly v. The time until then is known; the remainder of the step is an
exponential approach to r_i. So every step length is stable, and mean torques are those of these solutions.

**Passivity.** The stored energy is c0 times the sum of k_i z_i^2 / 2. A block that sticks, or slips with F_i <= a_i T,
dissipates power. One that slips with F_i = (1 + d) a_i T supplies v F_i + A_i d F_i, A_i = C a_i / (k_i c0), of which
c1 dissipates -c1 k_i A_i d v; the least of this over d > 0 is not negative where

    c1(v) |v| k_i <= a_i T(v) (1 + sqrt(|v| / A_i))^2    for every block.

With an attraction without bound that is c1 |v| <= T(v) a_i / k_i; LuGre's bound is 4 T(v).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from rx90_common.base.arrays import Array, RecordType, record_type
from rx90_common.friction.bristle import damping, decay, sliding_torque, viscous_torque
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, lane, load, prefix_sum, select, store

MAX_BLOCKS = 10
"""Of an element."""


class MaxwellBlocks(NamedTuple):
    """The blocks of one element, a lane for each of MAX_BLOCKS: those that are not there have no stiffness.

    Attributes:
        stiffness: in parts of c0.
        reach: deflection of steady sliding in parts of g(v), share / stiffness.
        attraction: Nm/s, a plain number.
    """

    stiffness: Lanes
    reach: Lanes
    attraction: float


def blocks_dtype(width: int) -> RecordType:
    """Return the type of the blocks of `width` elements, the element the first index."""
    blocks = (width, MAX_BLOCKS)
    return record_type(stiffness=blocks, reach=blocks, attraction=width)


@inlined
def load_blocks(arrays: Any, index: int) -> MaxwellBlocks:
    """Return the blocks of one element of such a record."""
    return MaxwellBlocks(
        load(arrays.stiffness[index], MAX_BLOCKS),
        load(arrays.reach[index], MAX_BLOCKS),
        arrays.attraction[index],
    )


@inlined
def weighted_squares(arrays: Any, index: int, state: Array) -> float:
    """Return the sum of stiffness, in parts of c0, times squared deflection, rad^2, over the blocks of one element."""
    total = 0.0
    for k in range(MAX_BLOCKS):
        total += arrays.stiffness[index, k] * state[0, k] * state[0, k]
    return total


@inlined
def _total(parts: Lanes) -> float:
    return lane(prefix_sum(parts), MAX_BLOCKS - 1)


@kernel
def maxwell_slip_torque(
    element: Any, arrays: Any, index: int, state: Array, velocity: float
) -> float:
    """Return the friction torque at one instant, Nm; arguments as those of `maxwell_slip_step`."""
    blocks = load_blocks(arrays, index)
    z = load(state[0], MAX_BLOCKS)
    sliding = sliding_torque(element, velocity)
    sense = 1.0 if velocity >= 0.0 else -1.0
    lacking = blocks.reach * (sliding / element.c0) - sense * z
    attracted = (blocks.attraction / sliding) * lacking
    speed = abs(velocity)
    bound = select(attracted < speed, attracted, speed)
    slips = select(
        load(state[1], MAX_BLOCKS) * sense > 0.0, bound, select(lacking > 0.0, speed, bound)
    )
    z_dot = sense * slips if speed > 0.0 else 0.0 * z
    rate = _total(blocks.stiffness * z_dot)
    bristles: float = element.c0 * _total(blocks.stiffness * z) + damping(element, velocity) * rate
    return bristles + viscous_torque(element, velocity)


@kernel
def maxwell_slip_step(
    element: Any, arrays: Any, index: int, state: Array, velocity: float, step: float
) -> tuple[float, float]:
    """Advance the blocks of one element by `step` seconds at constant velocity.

    Args:
        element: an `Elements` of rx90_common.friction.bristle, in plain numbers.
        arrays: record of `blocks_dtype`.
        index: of the element in it.
        state: deflections, rad, and the sense of the velocity with which a block slips, 0 if it sticks, shape
            (2, MAX_BLOCKS); advanced in place.
        velocity: rad/s.
        step: s.

    Returns:
        The blocks' new mean deflection, by their stiffness, rad, and the mean friction torque over the step, Nm.
    """
    blocks = load_blocks(arrays, index)
    z = load(state[0], MAX_BLOCKS)
    slipping = load(state[1], MAX_BLOCKS)
    before = _total(blocks.stiffness * z)
    if velocity == 0.0:
        return before, element.c0 * before
    sliding = sliding_torque(element, velocity)
    sense, speed = (1.0, velocity) if velocity > 0.0 else (-1.0, -velocity)
    steady = blocks.reach * (sliding / element.c0)
    rate = blocks.attraction / sliding
    y = sense * z
    already = slipping * sense > 0.0
    room = select(already, steady - speed / rate, steady) - y
    stuck = room / speed
    stuck = select(room > 0.0, select(stuck < step, stuck, step), 0.0)
    loaded = speed * stuck
    rest = steady - (y + loaded)
    left = step - stuck
    phi, psi = decay(rate * left)
    approached = rest * (rate * left) * phi
    moved = loaded + approached
    # Integrals of the deflection over the time that a block sticks, and over the time that it slips.
    over = stuck * (y + 0.5 * loaded) + left * (y + loaded + rest * (rate * left) * psi)
    store(state[0], sense * (y + moved))
    store(state[1], select(left > 0.0, sense, select(already, slipping, 0.0)))
    change = sense * _total(blocks.stiffness * moved)
    mean = sense * _total(blocks.stiffness * over) / step
    torque = (
        element.c0 * mean
        + damping(element, velocity) * change / step
        + viscous_torque(element, velocity)
    )
    return before + change, torque
