"""The number of plant steps in a tick, required by bristles, brakes, stops and gears and the arm's inertia.

**A stuck joint.** Where all bristles stick, a step of length h is linear. With the midpoint velocity that the last
acceleration predicts, v_m = v + h/2 a, the exact bristle, mean torque c0 (z + h/2 v_m) + d v_m, d = c1 and the viscous
slope at rest, and the mass m, its eigenvalues s are the roots of

    2 s (s - 1)^2 + [k + (k/2 + d) (s - 1)] (3 s - 1) = 0,    k = c0 h^2 / m,   d = d h / m.

By Jury's criterion they lie within the unit circle where d < 1 and (k - 2 d) (k + d) < 4 d. Without damping a vibration
grows by k^2 / 8 in a step, whatever the step.

**The arm.** Its map is the same polynomial with matrices M, K = W^T C0 W and D, where W maps velocities of the arm to
those of the elements. Multiplied by its eigenvector from the left, the polynomial is the scalar one, and k and d are
Rayleigh quotients. So k is at most the largest eigenvalue of (h^2 K, M), d that of (h D, M), also if only some of the
elements stick, and M^-1 K has the eigenvalues of sqrt(C0) (W M^-1 W^T) sqrt(C0). The largest entries of W M^-1 W^T over
poses in the whole range are computed once for an arm: a matrix of positive numbers that bounds another's entries also
bounds its eigenvalues (Perron and Frobenius).

**Bounds.** Friction: k <= 0.05, where a stuck joint's frequency is 1 % off, and d <= 0.5, half of the stable limit.
Closed brakes and end stops, which hold or stop the arm: k <= 0.25, d <= 0.8. The part of k that the damping does not
stabilise, by the criterion above, is limited so that a vibration grows by at most GROWTH in a second. Other bristles
have the stiffness of LuGre's while they stick.

**Elastic gears** are implicit, stable for every stiffness. But a frequency w far above the step rate is aliased to
another one, at which the controller may excite it: h w <= 0.5, unless damping d >= 0.05 h k removes it within some ten
steps.
Friction on the motors' side acts on the inertia of the rotors alone if the gear is soft; this inertia is used here.

**A weak direction.** Bristles that one direction has strained, with r times the torque of the other, slip back within
g of the weak one as soon as the joint turns. From rest under the strong torque this takes h sqrt(2 / (r k)), and while
they slip, dz/dt = (1 + r) v, so that c1 damps r times as much. Both are resolved where r k <= 0.5 and r d <= 1, also of
the mode: then the way is within 1 % of a stiff solver's, for any r.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rx90_common.arm_dynamics import body_dtype, manipulator_dtype, mass_and_bias
from rx90_common.base.arrays import Array, Record
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted
from rx90_common.description.coupling import Coupling
from rx90_common.description.drives import LINK, DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.friction import FrictionSet
from rx90_common.friction.element import FrictionElement
from rx90_common.kernels.compiled import kernel

MAX_AUTOMATIC_STEPS = 64
"""Largest number of steps in a tick that is used without a request."""

MAX_STEPS = 1000
"""Largest number of steps in a tick that can be requested."""

GROWTH = 0.1
"""By which a vibration of a stuck arm may grow in a second where nothing damps it, 1/s."""

# Roots of x^(n + 1) = x + 1 for n = 1 to 7.
_ROOTS = (
    1.618033988749895, 1.324717957244746, 1.2207440846057596, 1.1673039782614187, 1.1347241384015194, 1.112775684278706,
    1.0969815577985598,
)  # fmt: skip
_LARGE = 1e100  # beyond all that an eigenvalue can be computed of
_GEAR_DAMPING = 0.05  # d / (h k) from which a gear's vibration decays within some ten steps


class _Rows(NamedTuple):
    """The loads on the arm: friction elements, brakes, end stops, gears; each a stiffness and a damper.

    Attributes:
        stiffness: Nm/rad.
        damping: the least at rest, Nm s/rad.
        most_damping: the most up to full speed, Nm s/rad.
        bristle_damping: of the friction elements, Nm s/rad.
        ratios: of the friction torques of both directions, of the friction elements; 1 or more.
        elements: number of friction elements; brakes, stops and gears follow them.
    """

    stiffness: Array
    damping: Array
    most_damping: Array
    bristle_damping: Array
    ratios: Array
    elements: int

    @property
    def held(self) -> int:
        """Return how many are no gears."""
        return self.elements + 2 * (len(self.stiffness) - self.elements) // 3


class _Load(NamedTuple):
    """A quantity with its bound.

    Attributes:
        largest: eigenvalue.
        row: the one with the largest part in it.
        most: its bound.
        damps: whether it is a damping.
        weak: whether it is of a weak direction.
    """

    largest: float
    row: int
    most: float
    damps: bool
    weak: bool

    @property
    def over(self) -> float:
        """Return the quantity in parts of its bound."""
        return self.largest / self.most


def plant_steps(
    robot: RobotModel,
    drives: DriveParameters,
    friction: FrictionSet,
    arm: Any,
    period: float,
    requested: int | None = None,
) -> int:
    """Return the number of plant steps in a tick: the requested one, or the number that the arm needs.

    Args:
        robot: its limits.
        drives: brakes, end stops, gears.
        friction: the elements.
        arm: the rigid arm, shape (1,), of `manipulator_dtype(n)`; with the rotors.
        period: of a tick, s.
        requested: steps in a tick, None for as many as it needs.
    """
    rows = _rows(drives, friction, robot.max_velocity)
    gram = _compliance(
        arm.tobytes(),
        robot.lower.tobytes(),
        robot.upper.tobytes(),
        drives.rotor_inertia.tobytes(),
        drives.turning.turns.tobytes(),
        drives.elasticity.elastic.tobytes(),
        drives.elasticity.friction == LINK,
    )

    def bear(steps: int) -> bool:
        return all(load.largest <= load.most for load in _loads(rows, gram, period / steps))

    if bear(requested or 1):
        return requested or 1
    # all bounds ease with the step
    needed = 1 + bisect_left(range(1, MAX_STEPS + 1), True, key=bear)
    most = requested or MAX_AUTOMATIC_STEPS
    if needed <= most:
        return needed
    worst = max(_loads(rows, gram, period / most), key=lambda load: load.over)
    raise ConfigError(_refusal(friction.names, rows, gram, worst, most, needed))


def _ratio(element: FrictionElement) -> float:
    """Return how many times the friction torque of one direction is that of the other."""
    if element.curve is not None:
        return element.curve.ratio
    torques = element.tau_c.both, element.tau_s.both
    return max(max(both) / min(both) for both in torques)


def _rows(drives: DriveParameters, friction: FrictionSet, max_velocity: Array) -> _Rows:
    speeds = drives.turning.reach(max_velocity)
    slopes = [e.viscous_slopes(speed) for e, speed in zip(friction.elements, speeds, strict=True)]
    c1 = np.array([element.c1 for element in friction.elements])
    least, cold, fast = np.array(slopes).T
    at_rest = c1 + least
    most = np.maximum(c1 + cold, fast)
    elasticity = drives.elasticity
    gears = np.where(elasticity.elastic, elasticity.stiffness, 0.0)
    others = np.concatenate([drives.brake.damping, drives.end_stops.damping, elasticity.damping])
    return _Rows(
        np.concatenate(
            [
                [e.c0 for e in friction.elements],
                drives.brake.stiffness,
                drives.end_stops.stiffness,
                gears,
            ]
        ),
        np.concatenate([at_rest, others]),
        np.concatenate([most, others]),
        c1,
        np.array([_ratio(element) for element in friction.elements]),
        len(friction.elements),
    )


def _loads(rows: _Rows, gram: Array, step: float) -> Iterator[_Load]:
    """Yield the quantities with their bounds for a step, s."""
    k = step * step * rows.stiffness
    d = step * rows.damping
    still = math.sqrt(8.0 * GROWTH * step)  # k whose undamped vibration grows by GROWTH
    for part, most_k, most_d in ((slice(rows.elements), 0.05, 0.5), (slice(rows.held), 0.25, 0.8)):
        stiff = _load(k, part, gram, most_k)
        yield stiff
        yield _load(step * rows.most_damping, part, gram, most_d, damps=True)
        # up to this k the criterion lies above still + cover d
        cover = 3.2 / min(max(stiff.largest, 1e-100), most_k)
        with np.errstate(over="ignore"):  # damping that another check refuses
            bare = k - cover * d
        yield _load(bare, part, gram, still)
    strained = rows.ratios * step
    friction = slice(rows.elements)
    yield _load(strained * step * rows.stiffness[friction], friction, gram, 0.5, weak=True)
    yield _load(strained * rows.bristle_damping, friction, gram, 1.0, damps=True, weak=True)
    yield _load(k - d / _GEAR_DAMPING, slice(rows.held, None), gram, 0.25)


def _load(
    values: Array, part: slice, gram: Array, most: float, *, damps: bool = False, weak: bool = False
) -> _Load:
    """Return the largest eigenvalue of k or d, with its bound."""
    values = np.maximum(values[part], 0.0)
    largest = float(values.max())
    row = int(values.argmax())
    if largest > 0.0:
        root = np.sqrt(np.minimum(values, _LARGE))
        form = root[:, None] * gram[part, part] * root
        if largest < _LARGE:
            largest = float(np.linalg.eigvalsh(form)[-1])
            if largest > most:  # required of the mode
                row = int(np.argmax(np.abs(np.linalg.eigh(form)[1][:, -1])))
        else:  # others are negligible
            largest *= float(gram[part, part][row, row])
    return _Load(largest, row + (part.start or 0), most, damps, weak)


@lru_cache(maxsize=8)
def _compliance(
    arm: bytes,
    lower: bytes,
    upper: bytes,
    rotor: bytes,
    turns: bytes,
    elastic: bytes,
    link_friction: bool,
) -> Array:
    """Return the largest entries, by size, of W M^-1 W^T over the arm's range, 1/(kg m^2), shape (e + 3 n,) twice.

    The inertia that a row feels alone is the inverse of its entry on the diagonal.
    """
    low = np.frombuffer(lower)
    high = np.frombuffer(upper)
    inertia = np.diag(np.frombuffer(rotor))
    soft = np.frombuffer(elastic, np.bool_)
    n = len(soft)
    turning = Coupling(np.frombuffer(turns).reshape(n, n))
    coupling = turning.turns
    inputs = turning.element_matrix
    count = int(soft.sum())
    e = len(inputs)
    whole = np.zeros((n + count, n + count))
    if count:  # the motors run ahead of the links by twists
        whole[:n, n:] = (coupling.T @ inertia)[:, soft]
        whole[n:, :n] = (inertia @ coupling)[soft]
        whole[n:, n:] = inertia[np.ix_(soft, soft)]
    w = np.zeros((e + 3 * n, n + count))
    w[:e, :n] = inputs
    if not link_friction:  # of the joints as the motors have them, for those of the motors
        w[:e, n:] = (inputs @ np.linalg.inv(coupling))[:, soft]
    w[e : e + n, :n] = coupling
    w[e : e + n, n:] = np.eye(n)[:, soft]
    w[e + n : e + 2 * n, :n] = np.eye(n)
    w[e + 2 * n :, n:] = np.eye(n)[:, soft]
    # 128 points that fill a cube evenly: multiples of powers of a root, modulo 1 (Kronecker's sequence).
    shares = (
        0.5 + np.arange(1.0, 129.0)[:, None] * _ROOTS[n - 1] ** -np.arange(1.0, n + 1.0)
    ) % 1.0
    arms = np.frombuffer(arm, manipulator_dtype(n))
    masses = np.tile(whole, (len(shares), 1, 1))
    _masses(arms, np.zeros(1, body_dtype(n)), low + shares * (high - low), masses)
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused
            largest = np.abs(w @ np.linalg.solve(masses, w.T[None])).max(axis=0)
    except np.linalg.LinAlgError:
        largest = np.array(np.inf)
    if not np.isfinite(largest).all():
        raise ConfigError(
            f"drives.rotor_inertia is {np.diag(inertia).tolist()} kg m^2; accepted: inertias with which the arm's mass "
            "matrix can be inverted"
        )
    return np.asarray(largest)


@kernel
def _masses(arms: Record, bodies: Record, poses: Array, masses: Array) -> None:
    """Write the mass matrices of poses, shape (k, n), into the first rows and columns of others, (k, m, m)."""
    n = poses.shape[1]
    mass = np.empty((n, n))
    bias = np.empty(n)
    still = np.zeros(n)
    for k in range(len(poses)):
        mass_and_bias(arms[0], bodies[0], poses[k], still, mass, bias)
        masses[k, :n, :n] = mass


def _refusal(
    names: Sequence[str], rows: _Rows, gram: Array, load: _Load, most: int, needed: int
) -> str:
    """Return the message for a load that needs more than `most` steps in a tick; `names` are the elements'."""
    row = load.row
    kind = "damping" if load.damps else "stiffness"
    size = (rows.most_damping if load.damps else rows.stiffness)[row]
    cause = ""
    if row >= rows.elements:
        block, joint = divmod(row - rows.elements, (len(rows.stiffness) - rows.elements) // 3)
        name = f"drives.{('brake_', 'stop_', 'elasticity.')[block]}{kind}[{joint}]"
    elif not load.damps:
        name = f"friction.{names[row]}.c0"
    elif load.weak or rows.bristle_damping[row] >= 0.5 * size:
        name = f"friction.{names[row]}.c1"
        size = rows.bristle_damping[row]
    else:
        name = f"friction.{names[row]}.c2"
        cause = " at its steepest"
    if load.weak:
        cause = f" with torques {rows.ratios[row]:.4g} times apart in both directions"
    more = "" if needed > MAX_STEPS else f", or substeps {needed}"
    return (
        f"{name} is {size:.6g} {'Nm s/rad' if load.damps else 'Nm/rad'}{cause}, {load.over:.3g} times what "
        f"{counted(most, 'plant step')} in a tick can bear on {1.0 / gram[row, row]:.3g} kg m^2; accepted: up to about "
        f"{size / load.over:.3g}{more}"
    )
