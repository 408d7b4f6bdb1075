"""Friction and inertia of a group of joints along its micro-motions, as functions of the parameters of the fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.bristle_path import BristlePath

_DIFFERENCE = 1e-4  # relative step of difference quotients


@dataclass(frozen=True, eq=False)
class JointGroup:
    """Joints that share friction elements with each other and with no other joint.

    Attributes:
        joints: indices of the group's k joints.
        elements: indices of their e elements.
        inputs: velocities of these joints to input velocities of the elements, shape (e, k).
    """

    joints: tuple[int, ...]
    elements: tuple[int, ...]
    inputs: Array


def joint_groups(arm: RigidArm) -> list[JointGroup]:
    """Return the groups of an arm's joints, from base to tip."""
    groups = [{j} for j in range(len(arm.names))]
    for row in arm.element_matrix:
        joined: set[int] = set(np.flatnonzero(row).tolist())
        touched = [group for group in groups if group & joined]
        groups = [group for group in groups if not group & joined] + [set().union(*touched)]
    found = []
    for joints in sorted(tuple(sorted(group)) for group in groups):
        elements = np.flatnonzero(arm.element_matrix[:, list(joints)].any(axis=1))
        found.append(JointGroup(joints, tuple(elements.tolist()), arm.element_matrix[elements][:, list(joints)]))
    return found


@dataclass(frozen=True)
class ParameterVector:
    """What stands where in the parameters x of a group's fit.

    First ln c0 and ln c1, element by element; then errors of the mass matrix in parts of sqrt(M_jj M_ii); then the
    start deflections of the elements in parts of those of steady sliding, motion by motion. All micro-oscillations are
    made at one pose, so whatever the description of the links lacks is a constant error of the mass matrix.

    Attributes:
        elements: e of them.
        joints: indices of the group's k joints.
        arm_joints: n, of the whole arm.
        motions: micro-motions of the group.
    """

    elements: int
    joints: tuple[int, ...]
    arm_joints: int
    motions: int

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Return row and column of each free entry of the group's rows of the mass matrix: one of a symmetric pair.

        The other joints hardly move, by less than their encoders resolve.
        """
        k = len(self.joints)
        return [(j, self.joints[i]) for j in range(k) for i in range(j, k)]

    @property
    def bristles(self) -> int:
        """Return how many are ln c0 or ln c1; they come first."""
        return 2 * self.elements

    @property
    def shared(self) -> int:
        """Return how many belong to all motions; they come before the start deflections."""
        return self.bristles + len(self.pairs)

    @property
    def size(self) -> int:
        """Return how many there are."""
        return self.shared + self.elements * self.motions

    def start_columns(self, index: int) -> range:
        """Return where the start deflections of a motion stand."""
        first = self.shared + index * self.elements
        return range(first, first + self.elements)

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.exp(np.clip(x[: self.bristles], -20.0, 25.0)).reshape(-1, 2)

    def start(self, x: Array, index: int) -> Array:
        """Return the start deflections of a motion, shape (e,)."""
        return np.asarray(x[self.start_columns(index)])

    def inertia_errors(self, x: Array) -> Array:
        """Return the relative errors of the group's rows of the mass matrix, shape (k, n)."""
        errors = np.zeros((len(self.joints), self.arm_joints))
        for value, (j, i) in zip(x[self.bristles : self.shared], self.pairs, strict=True):
            errors[j, i] = value
            errors[self.joints.index(i), self.joints[j]] = value
        return errors


@dataclass(frozen=True, eq=False)
class GroupFriction:
    """Friction torques of a group along its micro-motions.

    Attributes:
        parameters: of the fit.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        sliding: the elements' sliding regime.
        speeds: input velocities of each motion, rad/s, shape (m, e).
        step: of each motion, s.
    """

    parameters: ParameterVector
    inputs: Array
    sliding: tuple[FrictionElement, ...]
    speeds: tuple[Array, ...]
    step: tuple[float, ...]
    _last: dict[tuple[int, int], tuple[tuple[float, float], tuple[Array, Array]]] = field(
        default_factory=dict, init=False
    )

    @cached_property
    def paths(self) -> list[list[BristlePath]]:
        """Return the paths of the elements along each motion."""
        return [
            [BristlePath.of(element, speed[:, n], step) for n, element in enumerate(self.sliding)]
            for speed, step in zip(self.speeds, self.step, strict=True)
        ]

    def with_element(self, n: int, element: FrictionElement) -> GroupFriction:
        """Return the same motions with another sliding regime of one element."""
        return replace(self, sliding=(*self.sliding[:n], element, *self.sliding[n + 1 :]))

    def deflection(self, x: Array, index: int, n: int) -> tuple[Array, Array]:
        """Return what `BristlePath.deflect` does of element n along a motion; the last result is kept."""
        key = float(self.parameters.values(x)[n, 0]), float(self.parameters.start(x, index)[n])
        known = self._last.get((index, n))
        if known is None or known[0] != key:
            known = self._last[index, n] = key, self.paths[index][n].deflect(*key)
        return known[1]

    def torque(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        values, total = self.parameters.values(x), []
        for n, path in enumerate(self.paths[index]):
            torque, rate = self.deflection(x, index, n)
            total.append(torque + values[n, 1] * rate + path.viscous)
        return np.column_stack(total) @ self.inputs

    def slopes(self, x: Array, index: int) -> tuple[list[Array], list[Array]]:
        """Return derivatives of the torque by ln c0 and ln c1 in turn, and by the start deflections, each (b, k)."""
        by_bristles, by_starts = [], []
        values, starts = self.parameters.values(x), self.parameters.start(x, index)
        for n, (path, (c0, c1), start) in enumerate(zip(self.paths[index], values, starts, strict=True)):
            torque, rate = self.deflection(x, index, n)
            here, row = torque + c1 * rate, self.inputs[n]
            stiffer, moved = path.deflect(c0 * (1.0 + _DIFFERENCE), start), path.deflect(c0, start + _DIFFERENCE)
            by_c0, by_start = ((one[0] + c1 * one[1] - here) / _DIFFERENCE for one in (stiffer, moved))
            by_bristles += [np.outer(by_c0, row), np.outer(c1 * rate, row)]
            by_starts.append(np.outer(by_start, row))
        return by_bristles, by_starts

    def loads(self, x: Array) -> Array:
        """Return the amplitude of each bristle's torque over its Coulomb torque, shape (motions, e)."""
        found = np.empty((len(self.paths), len(self.sliding)))
        for index, paths in enumerate(self.paths):
            for n, path in enumerate(paths):
                low, high = np.percentile(self.deflection(x, index, n)[0], (1.0, 99.0))
                found[index, n] = 0.5 * (high - low) / path.coulomb
        return found
