"""The observation equations of the sliding fit: friction and inertial errors in each block of a plateau.

A block gives, joint by joint, drive torque - rigid torque = E^T f + Y p with the friction torques f of the
elements and errors p of the inertial parameters (an unknown payload, a wrong mass). The torque of an element that
sticks is unknown, so only combinations of joints are kept in which no such element acts: the columns of N with
E_stuck N = 0. With joints 5 and 6 turning against each other, element 7 sticks, and the one combination left for it
is the difference of the two torques.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from rx90_common.base.arrays import Array
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.sliding.blocks import Blocks

_OBSERVABLE = 1e-2  # effect of an inertial error on all data together, in standard deviations of the noise


@dataclass(frozen=True, eq=False)
class SlidingRows:
    """Equations scaled to unit noise: `value` = sum over elements of gain * f(velocity) + nuisance @ p.

    Attributes:
        value: shape (r,).
        gain: of the elements' torques, 1/Nm, shape (r, n_el).
        velocity: of the elements, mean of the plateau, rad/s, shape (r, n_el).
        nuisance: coefficients of errors along k observable directions of the inertial parameters, shape (r, k); the
            prior of each error is 0 with a standard deviation of 1.
        directions: these directions, in SI units, shape (10 n, k).
        scale: square root of the number of samples in the row's block mean, shape (r,).
        group: joint whose noise the row has, shape (r,).
        plateau: shape (r,).
        source: number of the record, shape (r,).
        time: in the series, s, shape (r,).
    """

    value: Array
    gain: Array
    velocity: Array
    nuisance: Array
    directions: Array
    scale: Array
    group: NDArray[np.int64]
    plateau: NDArray[np.int64]
    source: NDArray[np.int64]
    time: Array

    def __len__(self) -> int:
        return len(self.value)

    def clusters(self) -> NDArray[np.int64]:
        """Return the number of each row's pair of plateau and group, shape (r,)."""
        pairs = np.column_stack([self.plateau, self.group])
        return np.asarray(np.unique(pairs, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def sliding_rows(blocks: Blocks, arm: RigidArm) -> SlidingRows:
    """Return the observation equations of all blocks, whitened by the covariance of the torques' noise."""
    motion = blocks.position, blocks.velocity, blocks.acceleration
    friction = blocks.torque - arm.torque(*motion)
    regressor = arm.regressor(*motion) * arm.inertial_scale()
    elements = arm.element_matrix
    velocity = _plateau_means(blocks.velocity @ elements.T, blocks.plateau)
    # The floor keeps the scaling finite for data without noise.
    floor = (1e-6 * np.abs(blocks.torque).max(axis=0)) ** 2 + 1e-18
    noise = blocks.noise + np.diag(floor)
    parts = []
    for pattern in np.unique(blocks.sliding, axis=0):
        combination = _unloaded(elements[~pattern])
        if combination.shape[1] == 0:
            continue
        rows = np.flatnonzero((blocks.sliding == pattern).all(axis=1))
        factor = np.linalg.cholesky(combination.T @ noise @ combination)
        white = solve_triangular(factor, combination.T, lower=True)  # (rows of a block, n)
        gain = white @ elements.T
        gain[:, ~pattern] = 0.0
        weight = np.sqrt(blocks.count[rows])
        height, width = len(rows), len(white)
        parts.append(
            SlidingRows(
                value=(weight[:, None] * (friction[rows] @ white.T)).ravel(),
                gain=(weight[:, None, None] * gain).reshape(height * width, -1),
                velocity=np.repeat(velocity[rows], width, axis=0),
                nuisance=(weight[:, None, None] * (white @ regressor[rows])).reshape(height * width, -1),
                directions=np.zeros((0, 0)),
                scale=np.repeat(weight, width),
                group=np.tile(np.abs(combination).argmax(axis=0), height),
                plateau=np.repeat(blocks.plateau[rows], width),
                source=np.repeat(blocks.source[rows], width),
                time=np.repeat(blocks.time[rows], width),
            )
        )
    joined = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(SlidingRows)}
    directions = _observable(joined["nuisance"])
    joined["nuisance"] = joined["nuisance"] @ directions
    joined["directions"] = arm.inertial_scale()[:, None] * directions
    return SlidingRows(**joined)


def _plateau_means(values: Array, plateau: NDArray[np.int64]) -> Array:
    count = np.bincount(plateau)
    total = np.zeros((len(count), values.shape[1]))
    np.add.at(total, plateau, values)
    return np.asarray((total / np.maximum(count, 1)[:, None])[plateau])


def back_substituted(upper: NDArray[Any], right: NDArray[Any]) -> Array:
    """Return x of upper @ x = right, shapes (n, n) and (n, k); SciPy 1.11 refuses n = 0."""
    return np.asarray(solve_triangular(upper, right)) if len(upper) else right


def _unloaded(stuck: Array) -> Array:
    """Return a sparse basis of the joint torques on which no stuck element acts, shape (n, k).

    Args:
        stuck: rows of E of the elements that stick, shape (s, n).
    """
    n = stuck.shape[1]
    if len(stuck) == 0:
        return np.eye(n)
    _, upper, order = qr(stuck, pivoting=True)
    rank = int(np.sum(np.abs(np.diag(upper)) > 1e-9))
    combination = np.zeros((n, n - rank))
    combination[order[:rank]] = -back_substituted(upper[:rank, :rank], upper[:rank, rank:])
    combination[order[rank:]] = np.eye(n - rank)
    combination[np.abs(combination) < 1e-12] = 0.0
    return combination


def _observable(nuisance: Array) -> Array:
    """Return the directions of the inertial parameters that the equations observe, shape (10 n, k)."""
    _, values, directions = np.linalg.svd(nuisance.T @ nuisance)
    return np.asarray(directions[np.sqrt(values) > _OBSERVABLE].T)
