"""Micro-motions with bristles of given kinds: what the torques in the band of micro-oscillations would be.

A bristle is deflected along the measured motion, and torques are compared at the frequencies of micro-oscillations
alone. The noise of the encoder, which reaches the torque through the controller, is there some thousandths of the
motion. The noise of the torque is in the measured side of the comparison only, so that it makes the estimates
uncertain, not biased. A simulation driven by the recorded torque would respond to its noise at the resonance as if it
were motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import decay
from rx90_common.friction.bristles.step import bristles_dtype
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.parts.bristles import MOST_BREAK_AWAY, BristlesPart, ElastoPlastic, MaxwellSlip, fill_bristles
from rx90_common.friction.tracing import BRISTLE_STATE_DTYPE, follow_bristles
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.presliding.micro_motion import BLOCK, MicroMotion, band_spectrum, block_means
from rx90_emulator.identification.records import BagSource

MAX_COMPARED_S: Final = 2.0
"""s of a micro-motion that are compared: they hold some six of its slowest waves."""
MOST_MOTIONS: Final = 5
"""Micro-motions of a joint that are compared, the largest ones."""
MOST_OF_BAG: Final = 3
"""The same of joints that share elements, of each bag."""
ATTRACTION: Final = "attraction"
"""The number of Maxwell slip that presliding does not show."""
_CACHED_SPECTRA = 16  # spectra of a motion: those of a difference quotient begin at the same deflection
_MAX_STEP_S = 5.1e-4  # s, of a step: at 33 Hz the mean over it is 0.1 % off
_ATTRACTION_RATE = 200.0  # 1/s: the sliding curve hardly shows in presliding, and its attraction not at all


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
    def kind(self) -> str:
        """Return "LuGre", "elasto-plastic" or "Maxwell slip"."""
        if self.blocks:
            return "Maxwell slip"
        return "elasto-plastic" if self.elastic else "LuGre"

    @property
    def name(self) -> str:
        """Return its name in a table."""
        return f"{self.kind} ({self.blocks} blocks)" if self.blocks else self.kind

    @property
    def count(self) -> int:
        """Return how many numbers of its own it has."""
        return 2 * (self.blocks - 1) if self.blocks else int(self.elastic)

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
        """Return the bristles of such numbers, for a Coulomb torque, Nm; None is LuGre's."""
        if self.elastic:
            return ElastoPlastic(float(MOST_BREAK_AWAY / (1.0 + np.exp(-np.clip(shape[0], -30.0, 30.0)))))
        if not self.blocks:
            return None
        parts = [np.exp(np.append(0.0, half)) for half in np.split(np.clip(shape, -8.0, 8.0), 2)]
        stiffness, share = (part / part.sum() for part in parts)
        # Blocks have no order of their own: in that in which they slip, fits without one motion each are compared.
        order = np.argsort(share / stiffness, kind="stable")
        return MaxwellSlip(tuple(stiffness[order].tolist()), tuple(share[order].tolist()), _ATTRACTION_RATE * coulomb)


FAMILIES = (KindFamily(), KindFamily(elastic=True), *(KindFamily(blocks) for blocks in (2, 3, 4)))
"""What is tried: LuGre, elasto-plastic, and Maxwell slip with 2 to 4 blocks."""


@kernel
def _deflect_lugre(speed: Array, sliding_torque: Array, step: float, c0: float, start: float, result: Array) -> None:
    """Deflect a bristle of LuGre's by the exact steps of the simulation.

    Of each step that a speed is held over, with c0 g(v) at it, `result` takes the means of the bristle's torque, Nm,
    and of the rate of deflection, rad/s, shape (m, 2).
    """
    z = start
    for row in range(len(speed)):
        v = speed[row]
        rate = c0 * abs(v) / sliding_torque[row]
        phi, psi = decay(rate * step)
        z_dot = v - rate * z
        result[row, 0] = c0 * (z + step * z_dot * psi)
        result[row, 1] = z_dot * phi
        z += step * z_dot * phi


@dataclass(frozen=True, eq=False)
class ElementTrace:
    """The motion of one friction element; what does not depend on c0 and c1 is computed once.

    Attributes:
        element: the sliding regime, with the c1 that fades at 1.
        speed: held over each step, rad/s, shape (m,).
        viscous: viscous torque, Nm, block means, shape (b,).
        step: s.
        steps: in a block.
    """

    element: FrictionElement
    speed: Array
    viscous: Array
    step: float
    steps: int
    _known: dict[tuple[BristlesPart | None, float, float], Array] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, element: FrictionElement, speed: Array, step: float, steps: int = BLOCK) -> ElementTrace:
        """Return the trace of an element by its sliding regime.

        Args:
            element: c0 and c1 are not used.
            speed: input velocities in steps of a record, rad/s, shape (m,).
            step: of the record, s.
            steps: of the trace in a block.
        """
        plain = replace(element.without_parts(), c1=1.0, c2=0.0)
        held = speed[: len(speed) // BLOCK * BLOCK].reshape(-1, BLOCK // steps).mean(axis=1)
        return cls(plain, held, block_means(element.viscous_torque(speed)), step * BLOCK / steps, steps)

    @property
    def position(self) -> Array:
        """Return the position from where the motion begins, rad, block means, shape (b,)."""
        return self._blocks(np.cumsum(self.speed) * self.step)

    def spectra(self, kind: BristlesPart | None, c0: float, start: float) -> Array:
        """Return spectra of what `bristles` returns, shape (r, 2); some are kept."""
        key = (kind, c0, start)
        if key not in self._known:
            if len(self._known) >= _CACHED_SPECTRA:
                del self._known[next(iter(self._known))]
            self._known[key] = self.spectrum(self.bristles(*key))
        return self._known[key]

    def spectrum(self, means: Array) -> Array:
        """Return the spectrum of block means, shape (b, c) to (r, c)."""
        return band_spectrum(means, self.step * self.steps / BLOCK)[0]

    def bristles(self, kind: BristlesPart | None, c0: float, start: float) -> Array:
        """Return block means of the bristles' torque, Nm, and of the rate that c1 multiplies, rad/s, shape (b, 2).

        Args:
            kind: of the bristles; None is LuGre's.
            c0: Nm/rad.
            start: deflection at the beginning over that of steady sliding.
        """
        first = start * self.element.tau_c_positive / c0
        found = np.empty((len(self.speed), 2))
        if kind is None:
            _deflect_lugre(self.speed, self._sliding_torque, self.step, c0, first, found)
        else:
            constants, state = np.zeros(1, bristles_dtype(1)), np.zeros(1, BRISTLE_STATE_DTYPE)
            fill_bristles(constants[0], [kind])
            state["z"] = first
            state["bristles"]["blocks"][0, 0, 0] = first * constants["blocks"]["reach"][0, 0]
            element = self._constants.copy()
            element["c0"] = c0
            torque, deflection = np.empty_like(self.speed), np.empty_like(self.speed)
            steps = np.full_like(self.speed, self.step)
            follow_bristles(element, constants, state, self.speed, steps, torque, deflection)
            found[:, 0], found[:, 1] = torque, np.diff(deflection, prepend=first) / self.step
        found[:, 1] *= self._fading
        return self._blocks(found)

    def _blocks(self, values: Array) -> Array:
        return np.asarray(values.reshape(-1, self.steps, *values.shape[1:]).mean(axis=1))

    @cached_property
    def _constants(self) -> NDArray[Any]:
        return element_arrays((replace(self.element, c1=0.0),))

    @cached_property
    def _sliding_torque(self) -> Array:
        return self.element.sliding_torque(self.speed)

    @cached_property
    def _fading(self) -> Array:
        return self.element.damping(self.speed)


@dataclass(frozen=True, eq=False)
class KindMotion:
    """A micro-motion of k joints with e friction elements, in the band.

    Attributes:
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        traces: of the elements.
        measured: what the bristles give at the joints, drive less weight, inertia and viscous torque, and what errors
            of the inertia would add, one for each pair of joints, as parts of sqrt(M_jj M_ii); Nm, block means,
            shape (b, k, 1 + p). Those of the other joints, which hardly move, are left out.
        target: the first of them as a spectrum, Nm, shape (r, k).
        inertial: the others, Nm, shape (r, k, p).
        line: Hz, rounded, of each of the r rows.
    """

    inputs: Array
    traces: tuple[ElementTrace, ...]
    measured: Array
    target: Array
    inertial: Array
    line: Array

    @classmethod
    def of(
        cls, motion: MicroMotion, inputs: Array, sliding: Sequence[FrictionElement], *, whole: bool = False
    ) -> KindMotion:
        """Return a micro-motion of a group.

        Args:
            motion: of the group's joints.
            inputs: as the attribute.
            sliding: the elements' sliding regime; c0 and c1 are not used.
            whole: whether all of it is taken, in the steps of the record, not its beginning in as few as will do.
        """
        steps = BLOCK if whole or 2.0 * motion.step > _MAX_STEP_S else BLOCK // 2
        used = slice(None if whole else round(MAX_COMPARED_S / motion.step))
        speed, acceleration = motion.velocity[used] @ inputs.T, motion.acceleration[used]
        traces = tuple(ElementTrace.of(one, speed[:, n], motion.step, steps) for n, one in enumerate(sliding))
        torques = [motion.friction[used]]
        for j, i in zip(*np.triu_indices(len(motion.joints)), strict=True):
            first, second = motion.joints[j], motion.joints[i]
            torques.append(np.zeros_like(torques[0]))
            scale = np.sqrt(motion.inertia[first] * motion.inertia[second])
            torques[-1][:, j] = scale * acceleration[:, second]
            torques[-1][:, i] = scale * acceleration[:, first]
        measured = block_means(np.stack(torques, axis=2))
        measured[:, :, 0] -= np.column_stack([trace.viscous for trace in traces]) @ inputs
        spectrum, frequency = band_spectrum(measured.reshape(len(measured), -1), motion.step)
        spectrum = spectrum.reshape(-1, *measured.shape[1:])
        return cls(inputs, traces, measured, spectrum[:, :, 0], spectrum[:, :, 1:], np.round(frequency))

    def with_trace(self, n: int, trace: ElementTrace) -> KindMotion:
        """Return the motion with another sliding regime, or other velocities, of element n."""
        more = np.outer(trace.viscous - self.traces[n].viscous, self.inputs[n])
        measured = self.measured.copy()
        measured[:, :, 0] -= more
        traces = (*self.traces[:n], trace, *self.traces[n + 1 :])
        return replace(self, traces=traces, measured=measured, target=self.target - trace.spectrum(more))


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

    def break_away(self, sliding: Sequence[FrictionElement]) -> Array:
        """Return the friction torque at which each joint slides, Nm, shape (k,), by its elements' sliding regime."""
        return np.asarray(np.abs(self.inputs).T @ np.array([one.tau_c_positive for one in sliding]))


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


@dataclass(frozen=True, eq=False)
class MovedGroup:
    """The largest micro-motions of joints that share their friction elements with no other joint.

    Attributes:
        elements: indices of its e elements.
        motions: the largest first; MOST_MOTIONS at most of a single element, else MOST_OF_BAG of each bag.
        c0: of LuGre's bristles, Nm/rad, shape (e,).
        sources: their bags.
    """

    elements: tuple[int, ...]
    motions: tuple[KindMotion, ...]
    c0: Array
    sources: tuple[BagSource, ...]

    @classmethod
    def of(
        cls, group: JointGroup, motions: Sequence[MicroMotion], sliding: Sequence[FrictionElement], c0: Array
    ) -> MovedGroup:
        """Return the largest of the micro-motions of a group, those shorter than MAX_COMPARED_S at the end.

        Args:
            group: the joints.
            motions: of them, one or more.
            sliding: the elements' sliding regime.
            c0: as the attribute.
        """
        break_away = group.break_away(sliding)
        bags: dict[str, list[MicroMotion]] = {}
        for motion in motions:
            # One direction of motion moves some elements only, and each is recorded in a bag of its own.
            bags.setdefault(motion.record.sha256 if len(group.elements) > 1 else "", []).append(motion)

        def rank(motion: MicroMotion) -> tuple[bool, float]:
            return len(motion.velocity) * motion.step < MAX_COMPARED_S, -motion.load(break_away)

        most = MOST_MOTIONS if len(group.elements) == 1 else MOST_OF_BAG
        largest = [motion for bag in bags.values() for motion in sorted(bag, key=rank)[:most]]
        compared = tuple(KindMotion.of(motion, group.inputs, sliding) for motion in largest)
        return cls(group.elements, compared, c0, tuple(dict.fromkeys(motion.record.bag for motion in largest)))
