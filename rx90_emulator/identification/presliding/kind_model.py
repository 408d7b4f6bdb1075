"""A joint's micro-motion with bristles of a given kind: what the torque in the band of micro-oscillations would be."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import load_elements
from rx90_common.friction.bristles.step import bristles_dtype, bristles_state_dtype, bristles_step
from rx90_common.friction.element import element_arrays
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip, fill_bristles
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load
from rx90_emulator.identification.presliding.band import band_spectrum, block_means
from rx90_emulator.identification.presliding.micro_motion import MicroMotion

LONGEST = 2.0
"""s of a micro-motion that are compared: they hold some six of its slowest waves."""

_ATTRACTION = 200.0  # 1/s: the sliding curve hardly shows in presliding, and its attraction not at all
_STATE = np.dtype([("z", np.float64, (1,)), ("bristles", bristles_state_dtype(1))], align=True)


@dataclass(frozen=True)
class KindFamily:
    """Bristles of one kind, with numbers without bounds for its parameters.

    Attributes:
        blocks: 0 for a bristle with one deflection.
        elastic: whether it is elasto-plastic.
    """

    blocks: int = 0
    elastic: bool = False

    @property
    def name(self) -> str:
        """Return its name in a table."""
        if self.blocks:
            return f"Maxwell slip, {self.blocks} blocks"
        return "elasto-plastic" if self.elastic else "LuGre"

    def guesses(self) -> list[Array]:
        """Return where fits may begin."""
        if self.elastic:
            return [np.array([0.0]), np.array([1.2])]
        if not self.blocks:
            return [np.zeros(0)]
        # The stiffness of LuGre's virgin curve falls as exp(-x / g): blocks of equal stiffness with these reaches.
        reach = -np.log1p(-(np.arange(self.blocks) + 0.5) / self.blocks)
        return [np.concatenate([np.zeros(self.blocks - 1), np.log(reach[1:] / reach[0])])]

    def bristles(self, shape: Array, coulomb: float) -> BristlesPart | None:
        """Return the bristles of such numbers, for a Coulomb torque, Nm."""
        if self.elastic:
            return ElastoPlastic(float(0.9 / (1.0 + np.exp(-np.clip(shape[0], -30.0, 30.0)))))
        if not self.blocks:
            return None
        stiffness, share = (_parts(half) for half in np.split(np.clip(shape, -8.0, 8.0), 2))
        return MaxwellSlip(stiffness, share, _ATTRACTION * coulomb)


def _parts(logarithms: Array) -> tuple[float, ...]:
    weights = np.exp(np.append(0.0, logarithms))
    return tuple((weights / weights.sum()).tolist())


FAMILIES = (KindFamily(), KindFamily(elastic=True), *(KindFamily(blocks) for blocks in (2, 3, 4)))
"""What is tried: LuGre, elasto-plastic, and Maxwell slip with 2 to 4 blocks."""


@dataclass(frozen=True, eq=False)
class KindMotion:
    """A micro-motion of a joint with one element of its own, in the band.

    Attributes:
        element: the sliding regime; c0 and c1 are not used.
        speed: held over each step, rad/s, shape (m,).
        step: s.
        target: spectrum of what the bristles give: drive less weight, inertia and viscous torque, Nm, shape (r,).
        inertial: spectrum of the joint's inertia times its acceleration, Nm, shape (r,).
        line: Hz, rounded, of each of the r numbers.
    """

    element: FrictionElement
    speed: Array
    step: float
    target: Array
    inertial: Array
    line: Array
    _known: dict[tuple[BristlesPart | None, float, float], tuple[Array, Array]] = field(
        default_factory=dict, init=False
    )

    @classmethod
    def of(cls, motion: MicroMotion, element: FrictionElement) -> KindMotion:
        """Return the beginning of a micro-motion of one joint."""
        used = slice(round(LONGEST / motion.step))
        speed, joint = np.ascontiguousarray(motion.velocity[used, 0]), motion.joints[0]
        acceleration = motion.acceleration[used]
        torque = motion.drive[used, 0] - acceleration @ motion.mass[0] - element.viscous_torque(speed)
        both = np.column_stack([torque, motion.inertia[joint] * acceleration[:, joint]])
        spectrum, frequency = band_spectrum(block_means(both), motion.step)
        plain = replace(element.without_parts(), c1=0.0, c2=0.0)
        return cls(plain, speed, motion.step, spectrum[:, 0], spectrum[:, 1], np.round(frequency))

    def bristles(self, kind: BristlesPart | None, c0: float, start: float) -> tuple[Array, Array]:
        """Return spectra of the bristles' torque, Nm, and of the rate that c1 multiplies, rad/s.

        Args:
            kind: of the bristles.
            c0: Nm/rad.
            start: deflection at the beginning over that of steady sliding.
        """
        key = (kind, c0, start)
        if key not in self._known:
            self._known.clear()
            result = np.empty((self.speed.size, 2))
            element = replace(self.element, c0=c0, bristles=kind)
            constants, state = np.zeros(1, bristles_dtype(1)), np.zeros(1, _STATE)
            fill_bristles(constants[0], [kind])
            state["z"] = start * element.tau_c_positive / c0
            state["bristles"]["blocks"][0, 0, 0] = state["z"][0] * constants["blocks"]["reach"][0, 0]
            fading = replace(element, c1=1.0).damping(self.speed)
            _follow(element_arrays((element,)), constants, state, self.speed, self.step, result)
            result[:, 1] *= fading
            spectrum = band_spectrum(block_means(result), self.step)[0]
            self._known[key] = spectrum[:, 0], spectrum[:, 1]
        return self._known[key]


@kernel
def _follow(elements: Any, constants: Any, states: Any, speed: Array, step: float, result: Array) -> None:
    element, kinds, state = load_elements(elements[0], 1), constants[0], states[0].bristles
    z = load(states[0].z, 1)
    nothing = 0.0 * z
    for row in range(speed.size):
        new, torque = bristles_step(element, kinds, state, z, nothing + speed[row], step, 1)
        result[row, 0] = lane(torque, 0)
        result[row, 1] = (lane(new, 0) - lane(z, 0)) / step
        z = new
