"""Everything in an arm's torque that is linear in its parameters, friction apart: links, rotors, springs, offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_emulator.identification.model.rigid_arm import RigidArm

_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True, eq=False)
class StandardColumns:
    """The torque of an arm per unit of each standard parameter.

    Attributes:
        arm: kinematics and couplings; of its inertias nothing is used.
        springs: joints with a spring of the torque -k sin(q), numbers from 0.

    Raises:
        IdentificationError: for a spring on a joint that is not there.
    """

    arm: RigidArm
    springs: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for joint in self.springs:
            if not 0 <= joint < len(self.arm.names):
                raise IdentificationError(f"spring on joint {joint}; accepted: 0 to {len(self.arm.names) - 1}")

    @classmethod
    def with_springs_on(cls, arm: RigidArm, joints: Sequence[str]) -> StandardColumns:
        """Return the columns of an arm with springs on the named joints.

        Raises:
            IdentificationError: for a joint that is not there.
        """
        for name in joints:
            if name not in arm.names:
                raise IdentificationError(f"spring on joint {quoted(name)}; accepted: {listed(arm.names)}")
        return cls(arm, tuple(arm.names.index(name) for name in joints))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of P parameters; numbers are those of the joints, from 1 at the base.

        m kg, mx .. mz kg m and Ixx .. Izz kg m^2 of the links, about the origins of their joints and in their frames;
        Ia kg m^2, of the motors through their gears; k Nm, of the springs; offset Nm.
        """
        n = len(self.arm.names)
        links = [f"{kind}_{joint}" for joint in range(1, n + 1) for kind in _LINK]
        rotors = [f"Ia_{joint}" for joint in range(1, n + 1)]
        springs = [f"k_{joint + 1}" for joint in self.springs]
        return (*links, *rotors, *springs, *(f"offset_{joint}" for joint in range(1, n + 1)))

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the columns along a motion, whose arrays have shape (m, n): shape (m, n, P)."""
        n, turns = len(self.arm.names), self.arm.coupling
        links = self.arm.regressor(position, velocity, acceleration)
        # Motor j turns with row j of the coupling; its inertia acts back on every joint of that row.
        rotors = (acceleration @ turns.T)[:, None, :] * turns.T
        springs = np.zeros((len(position), n, len(self.springs)))
        for k, joint in enumerate(self.springs):
            springs[:, joint, k] = np.sin(position[:, joint])
        offsets = np.broadcast_to(np.eye(n), (len(position), n, n))
        return np.concatenate([links, rotors, springs, offsets], axis=2)

    def values(self) -> Array:
        """Return the parameters as the arm's description has them, shape (P,): a prior. Offsets are 0."""
        inverse = np.linalg.inv(self.arm.coupling)
        rotors = np.diag(inverse.T @ self.arm.rotor @ inverse)
        springs = self.arm.spring[list(self.springs)]
        return np.concatenate([self.arm.inertial, rotors, springs, np.zeros(len(self.arm.names))])
