"""Rows of sweeps: what the plateaus of records say about the steady friction of the elements.

A block of a plateau gives, joint by joint, drive torque - rigid torque = E^T f + Y p with the friction torques f of the
elements and errors p of the arm's inertial parameters (an unknown payload, a wrong mass). An element that sticks
carries any torque, so only combinations of joints are used in which no such element acts: with joints 5 and 6 turning
against each other, element 5+6 sticks, and what remains is the difference of the two torques.

An element has one velocity in a plateau, hence one torque. So a plateau gives three rows: the mean of its blocks, with
friction, and slope and bend over them, which tell of the weight alone. The mean has a noise of its own: it contains
what all blocks share, such as ripple, temperature, or an arm that is not quite rigid. Longer plateaus weigh more, up to
some seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.stats import trim_mean

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.elements import FrictionRows, SteadyRows
from rx90_common.estimation.law import Speeds
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.rows.plateaus import BagUse, Plateau, find_plateaus, velocity
from rx90_emulator.identification.sanity import LAGS

_TRIMMED = 0.15  # of a block's samples at either end of their order: spikes
# plateau that weighs more than shorter ones: beyond it the mean has what all samples share
_LONGEST_S = 2.0
_INDEPENDENT = 1e-9


class Blocks(NamedTuple):
    """Means over the b blocks of p plateaus of n joints.

    Attributes:
        motion: positions, rad, velocities, rad/s, and accelerations, rad/s^2, shape (3, b, n).
        later: the torque that was recorded later by each of LAGS, Nm, shape (l, b, n).
        plateau: number of each block's plateau, shape (b,).
        velocity: of the elements in each plateau, rad/s, shape (p, n_el).
        sliding: which elements slide in it, shape (p, n_el).
        duration: of it, s, shape (p,).
    """

    motion: Array
    later: Array
    plateau: Index
    velocity: Array
    sliding: Mask
    duration: Array


def find_blocks(
    records: Sequence[JointRecord], elements: Array
) -> tuple[Blocks, tuple[BagUse, ...]]:
    """Return the block means of all plateaus of records, and the account of each record.

    Args:
        records: of the same joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
    """
    usage = []
    means = []
    later = []
    velocities = []
    sliding = []
    duration = []
    for record in records:
        plateaus, use = find_plateaus(record, elements)
        usage.append(use)
        sums = np.cumsum(np.insert(record.torque, 0, 0.0, axis=0), axis=0)
        for plateau in plateaus:
            means.append(_block_means(record, plateau))
            later.append(_later_means(record, plateau, sums))
            velocities.append(elements @ velocity(record, plateau.rows))
            sliding.append(plateau.sliding)
            duration.append(np.ptp(record.time[plateau.rows]))
    if not means:
        reasons = "; ".join(f"{use.bag.path}: {use.left_out}" for use in usage)
        raise IdentificationError(
            f"{reasons or 'no bag'}: no stretch of constant velocity; accepted: sweeps at constant velocity"
        )
    joined = np.concatenate(means, axis=1)
    lagged = np.concatenate(later, axis=1)
    lagged[len(LAGS) // 2] = joined[3]
    blocks = Blocks(
        motion=joined[:3],
        later=lagged,
        plateau=np.repeat(np.arange(len(means)), [part.shape[1] for part in means]),
        velocity=np.array(velocities),
        sliding=np.array(sliding),
        duration=np.array(duration),
    )
    return blocks, tuple(usage)


def _block_means(record: JointRecord, plateau: Plateau) -> Array:
    """Return position, velocity, acceleration and torque of a plateau's blocks, shape (4, b, n)."""
    rows = plateau.rows
    acceleration = np.polyfit(record.time[rows], record.velocity[rows], 1)[0]
    mean = velocity(record, rows)
    blocks = [slice(begin, end) for begin, end in plateau.blocks.tolist()]
    position = np.array([record.position[block].mean(axis=0) for block in blocks])
    torque = np.array([trim_mean(record.torque[block], _TRIMMED) for block in blocks])
    motion = np.broadcast_to(mean, position.shape), np.broadcast_to(acceleration, position.shape)
    return np.stack([position, *motion, torque])


def _later_means(record: JointRecord, plateau: Plateau, sums: Array) -> Array:
    """Return a plateau's means of the torque at all lags, shape (l, b, n), by the sums of it, shape (m + 1, n)."""
    rows = plateau.rows
    lag = np.clip(np.round(LAGS / record.period), -rows.start, len(record.time) - rows.stop).astype(
        np.intp
    )
    begin, end = plateau.blocks.T
    return np.asarray(
        (sums[end + lag[:, None]] - sums[begin + lag[:, None]]) / (end - begin)[:, None]
    )


class SweepRows(NamedTuple):
    """The rows of sweeps.

    Attributes:
        friction: rows of the elements with a law; its linear parameters are the errors of the inertial parameters,
            in units of `RigidArm.inertial_scale`.
        slopes: group of the rows that have the noise of the samples alone, for each row, shape (r,).
    """

    friction: FrictionRows
    slopes: Index


def sweep_rows(blocks: Blocks, arm: RigidArm, elements: Index) -> SweepRows:
    """Return the rows of all plateaus in which only some elements slide.

    Args:
        blocks: of the plateaus.
        arm: rigid-body model.
        elements: numbers of the elements with a law; the others count as sticking.
    """
    slide = blocks.sliding & np.isin(np.arange(len(arm.element_names)), elements)
    torque = blocks.later[len(LAGS) // 2] - arm.torque(*blocks.motion)
    # The torque and its derivatives by the inertial parameters.
    columns = arm.regressor(*blocks.motion) * arm.inertial_scale()
    both = np.concatenate([torque[:, :, None], columns], axis=2)
    parts = []
    gains = []
    plateaus = []
    groups = []
    for number, sliding in enumerate(slide):
        combination = _unloaded(arm.element_matrix[~sliding])
        gain = combination.T @ arm.element_matrix.T * sliding
        told = gain.any(axis=1)
        joint = np.abs(combination[:, told]).argmax(axis=0)
        of_plateau = np.einsum("jk,bjc->bkc", combination[:, told], both[blocks.plateau == number])
        weight = np.sqrt(min(blocks.duration[number], _LONGEST_S))
        for order, shape in enumerate(_shapes(len(of_plateau))):
            parts.append(weight * np.tensordot(shape, of_plateau, 1))
            gains.append(weight * gain[told] * (order == 0))
            plateaus.append(np.full(len(joint), number))
            groups.append(2 * joint + min(order, 1))
    joined = np.concatenate(parts)
    gain = np.concatenate(gains)
    plateau = np.concatenate(plateaus)
    group = np.concatenate(groups)
    numbers = np.unique(group)
    slopes = np.where(np.isin(group | 1, numbers), group | 1, group)
    steady = []
    for e in elements.tolist():
        rows = np.flatnonzero(gain[:, e])
        velocity = blocks.velocity[plateau[rows], e]
        speed = np.abs(velocity)
        speeds = Speeds(float(speed.min()), float(speed.max()))
        steady.append(SteadyRows(rows, velocity, gain[rows, e], speeds))
    friction = FrictionRows(
        target=joined[:, 0],
        linear=joined[:, 1:],
        elements=steady,
        group=np.searchsorted(numbers, group),
        block=plateau,
        prior=np.eye(joined.shape[1] - 1),
    )
    return SweepRows(friction, np.searchsorted(numbers, slopes))


def _shapes(count: int) -> Array:
    """Return what a plateau of so many blocks is multiplied by: mean, slope and bend, as far as it has them, (<= 3, b).

    White noise of the blocks is the same in all.
    """
    powers = np.vander(np.linspace(-1.0, 1.0, count), min(count, 3), increasing=True)
    basis = np.linalg.qr(powers)[0].T
    return np.asarray(basis * np.sign(basis[0, 0]) / np.sqrt(count))


def _unloaded(stuck: Array) -> Array:
    """Return a sparse basis of the joint torques on which no stuck element, a row of E each, acts, shape (n, k)."""
    n = stuck.shape[1]
    if len(stuck) == 0:
        return np.eye(n)
    _, upper, order = qr(stuck, pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > _INDEPENDENT))
    combination = np.zeros((n, n - rank))
    combination[order[:rank]] = -np.linalg.solve(upper[:rank, :rank], upper[:rank, rank:])
    combination[order[rank:]] = np.eye(n - rank)
    combination[np.abs(combination) < _INDEPENDENT] = 0.0
    return combination
