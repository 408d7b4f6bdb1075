"""Micro-motions with bristles of given kinds: the predicted torques in the band of micro-oscillations.

A bristle is deflected along the measured motion, and torques are compared at the frequencies of micro-oscillations
alone. In this band the noise of the encoder, which reaches the torque through the controller, is some thousandths of
the motion. The noise of the torque is contained in the measured side of the comparison only, so it makes the estimates
uncertain, not biased. A simulation driven by the recorded torque would respond to its noise at the resonance as if it
were motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse.csgraph import connected_components

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import decay
from rx90_common.friction.compiled_elements import BRISTLE_STATE_DTYPE, bristles_dtype, element_arrays, follow_bristles
from rx90_common.friction.parts.bristles import MAX_BREAK_AWAY, BristlesPart, ElastoPlastic, MaxwellSlip, fill_bristles
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.presliding.micro_motion import BLOCK, MicroMotion, band_spectrum
from rx90_emulator.identification.records import block_means

MAX_COMPARED_S: Final = 2.0
"""Longest compared part of a micro-motion, s: it contains some six of its slowest waves."""
MAX_MOTIONS_ALONE: Final = 5
"""Largest number of compared micro-motions of a joint with elements of its own."""
MAX_MOTIONS_OF_BAG: Final = 3
"""The same for joints that share elements, from each bag."""
ATTRACTION: Final = "attraction"
"""The parameter of Maxwell slip that has no effect in presliding."""
INERTIA_SD: Final = 0.05
"""Prior standard deviation of the errors of the mass matrix, in units of sqrt(M_jj M_ii)."""
_CACHED_SPECTRA = 16  # of a motion: difference quotients use the same start deflection again
_MAX_STEP_S = 5.1e-4  # s, of a step: at 33 Hz the mean over it is 0.1 % off
_ATTRACTION_RATE = 200.0  # 1/s: the sliding curve has little effect in presliding, and its attraction none
_PARAMETER_STEP = 1e-4  # step of difference quotients, for parameters of the order of 1


@dataclass(frozen=True)
class KindFamily:
    """Bristles of one kind, with unbounded numbers for its parameters.

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
        """Return the number of parameters of its own."""
        return 2 * (self.blocks - 1) if self.blocks else int(self.elastic)

    def guesses(self) -> list[Array]:
        """Return start values for fits."""
        if self.elastic:
            return [np.array([0.0]), np.array([1.2])]
        if not self.blocks:
            return [np.zeros(0)]
        # The stiffness of LuGre's virgin curve falls as exp(-x / g): blocks of equal stiffness with these reaches.
        reach = -np.log1p(-(np.arange(self.blocks) + 0.5) / self.blocks)
        return [np.concatenate([np.zeros(self.blocks - 1), np.log(reach[1:] / reach[0])])]

    def bristles(self, shape: Array, coulomb: float) -> BristlesPart | None:
        """Return the bristles with such numbers, for a Coulomb torque, Nm; None for LuGre's."""
        if self.elastic:
            return ElastoPlastic(float(MAX_BREAK_AWAY / (1.0 + np.exp(-np.clip(shape[0], -30.0, 30.0)))))
        if not self.blocks:
            return None
        parts = [np.exp(np.append(0.0, half)) for half in np.split(np.clip(shape, -8.0, 8.0), 2)]
        stiffness, share = (part / part.sum() for part in parts)
        # Blocks are sorted in the order in which they slip, so that fits without one motion each can be compared.
        order = np.argsort(share / stiffness, kind="stable")
        return MaxwellSlip(tuple(stiffness[order].tolist()), tuple(share[order].tolist()), _ATTRACTION_RATE * coulomb)


FAMILIES = (KindFamily(), KindFamily(elastic=True), *(KindFamily(blocks) for blocks in (2, 3, 4)))
"""Kinds that are tried: LuGre, elasto-plastic, and Maxwell slip with 2 to 4 blocks."""


@kernel
def _deflect_lugre(speed: Array, sliding_torque: Array, step: float, c0: float, start: float, result: Array) -> None:
    """Deflect one of LuGre's bristles by the exact steps of the simulation.

    For each step of constant speed, with c0 g(v) for this speed, `result` receives the means of the bristle's torque,
    Nm, and of the rate of deflection, rad/s, shape (m, 2).
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
    """The motion of one friction element; terms that do not depend on c0 and c1 are computed once.

    Attributes:
        element: the sliding regime, with the c1 that fades at 1.
        speed: constant in each step, rad/s, shape (m,).
        viscous: viscous torque, Nm, block means, shape (b,).
        step: s.
        steps: in a block.
    """

    element: FrictionElement
    speed: Array
    viscous: Array
    step: float
    steps: int

    @classmethod
    def of(cls, element: FrictionElement, speed: Array, step: float, steps: int = BLOCK) -> ElementTrace:
        """Return the trace of an element, c0 and c1 of which are not used, at input velocities in a record's steps."""
        plain = replace(element.without_parts(), c1=1.0, c2=0.0)
        viscous = block_means(element.viscous_torque(speed), BLOCK)
        block_speed = block_means(speed[: len(viscous) * BLOCK], BLOCK // steps)
        return cls(plain, block_speed, viscous, step * BLOCK / steps, steps)

    @property
    def position(self) -> Array:
        """Return the position relative to the beginning of the motion, rad, block means, shape (b,)."""
        return block_means(np.cumsum(self.speed) * self.step, self.steps)

    @cached_property
    def spectra(self) -> Callable[[BristlesPart | None, float, float], Array]:
        """Return a function for the spectra of the results of `bristles`, shape (r, 2), with a cache."""
        return lru_cache(_CACHED_SPECTRA)(lambda *bristle: self.spectrum(self.bristles(*bristle)))

    def spectrum(self, means: Array) -> Array:
        """Return the spectrum of block means, shape (b, c) to (r, c)."""
        return band_spectrum(means, self.step * self.steps / BLOCK)[0]

    def bristles(self, kind: BristlesPart | None, c0: float, start: float) -> Array:
        """Return block means of the bristles' torque, Nm, and of the rate that c1 multiplies, rad/s, shape (b, 2).

        Args:
            kind: of the bristles; None for LuGre's.
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
        return block_means(found, self.steps)

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
        measured: torque of the bristles at the joints, drive less weight, inertia and viscous torque, and the
            contributions of errors of the inertia, one for each pair of joints, in units of sqrt(M_jj M_ii); Nm, block
            means, shape (b, k, 1 + p). Errors of the other joints' inertia, which hardly move, are neglected.
        target: the first of them as a spectrum, Nm, shape (r, k).
        inertial: the others, Nm, shape (r, k, p).
        line: frequency of each of the r rows, Hz, rounded.
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
            whole: whether all of it is used, in the steps of the record, instead of its beginning in as few steps as
                suffice.
        """
        steps = BLOCK if whole or 2.0 * motion.step > _MAX_STEP_S else BLOCK // 2
        used = slice(None if whole else round(MAX_COMPARED_S / motion.step))
        speed, acceleration = motion.velocity[used] @ inputs.T, motion.acceleration[used][:, list(motion.joints)]
        traces = tuple(ElementTrace.of(one, speed[:, n], motion.step, steps) for n, one in enumerate(sliding))
        torques, scale = [motion.friction[used]], motion.inertia_scale
        for j, i in zip(*np.triu_indices(len(scale)), strict=True):
            torques.append(np.zeros_like(torques[0]))
            torques[-1][:, j] = scale[j, i] * acceleration[:, i]
            torques[-1][:, i] = scale[j, i] * acceleration[:, j]
        measured = block_means(np.stack(torques, axis=2), BLOCK)
        measured[:, :, 0] -= np.column_stack([trace.viscous for trace in traces]) @ inputs
        spectrum, frequency = band_spectrum(measured.reshape(len(measured), -1), motion.step)
        spectrum = spectrum.reshape(-1, *measured.shape[1:])
        return cls(inputs, traces, measured, spectrum[:, :, 0], spectrum[:, :, 1:], np.round(frequency))

    def changed(self, n: int, element: FrictionElement, speed: Array | None = None) -> KindMotion:
        """Return a whole motion with another sliding regime, and other velocities if given, of element n."""
        before = self.traces[n]
        trace = ElementTrace.of(element, before.speed if speed is None else speed, before.step)
        more = np.outer(trace.viscous - before.viscous, self.inputs[n])
        measured = self.measured.copy()
        measured[:, :, 0] -= more
        traces = (*self.traces[:n], trace, *self.traces[n + 1 :])
        return replace(self, traces=traces, measured=measured, target=self.target - trace.spectrum(more))


@dataclass(frozen=True, eq=False)
class GroupModel:
    """Residuals of M motions for bristles of given kinds of a group's e elements, as a function of parameters x.

    x contains ln c0, the damping, and the kind's own numbers, element by element; then the errors of the inertia, in
    units of sqrt(M_jj M_ii); then the start deflections in units of those of steady sliding, motion by motion. All
    micro-oscillations are made at one pose, so errors of the links' description are a constant error of the inertia.

    Attributes:
        families: of the elements.
        motions: M of them.
        scale: unit of the residuals, Nm, shape (k,).
        unit: of c1 among the parameters, Nm s/rad, shape (e,); None if the parameter is ln c1.
        start_sd: prior standard deviation of a start deflection over that of steady sliding.
        max_start: largest start deflection in the same unit.
    """

    families: tuple[KindFamily, ...]
    motions: tuple[KindMotion, ...]
    scale: Array
    unit: Array | None = None
    start_sd: float = 1.0
    max_start: float = 1.2

    @cached_property
    def places(self) -> list[slice]:
        """Return the slices of the parameters of each element."""
        ends = np.cumsum([0, *(2 + family.count for family in self.families)]).tolist()
        return [slice(a, b) for a, b in pairwise(ends)]

    @property
    def inertial(self) -> slice:
        """Return the slice of the errors of the inertia: behind the elements', before the start deflections."""
        first = self.places[-1].stop
        return slice(first, first + int(self.motions[0].inertial.shape[2]))

    def starts(self, x: Array) -> Array:
        """Return the start deflections of the motions, in parts of those of steady sliding, shape (M, e)."""
        return x[self.inertial.stop :].reshape(-1, len(self.families))

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.array([(_exp(x[place][0]), self._c1(x[place], n)) for n, place in enumerate(self.places)])

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the residual spectrum of a motion in units of the scale, shape (r, k)."""
        motion = self.motions[index]
        residual = motion.target - motion.inertial @ x[self.inertial]
        for n, (place, start) in enumerate(zip(self.places, self.starts(x)[index], strict=True)):
            torque = self._spectra(x[place], n, index, start) @ (1.0, self._c1(x[place], n))
            residual = residual - np.outer(torque, motion.inputs[n])
        return np.asarray(residual / self.scale)

    def of_all(self, x: Array) -> Array:
        """Return the residual spectra of all motions in units of the scale, shape (sum of r, k)."""
        return np.vstack([self.of_motion(x, index) for index in range(len(self.motions))])

    def residual(self, x: Array) -> Array:
        """Return the residuals of all motions, then those of the prior."""
        return np.concatenate([self.of_all(x).ravel(), x[self.inertial.start :] / self._prior_sd(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of `residual`."""
        rows = [-(self._slopes(x, i) / self.scale[:, None]).reshape(-1, x.size) for i in range(len(self.motions))]
        prior_sd = self._prior_sd(x)
        return np.vstack([*rows, np.eye(len(prior_sd), x.size, self.inertial.start) / prior_sd[:, None]])

    def minimised(self, x: Array, most: int, xtol: float, ftol: float) -> OptimizeResult:
        """Return the least-squares result from start parameters x, with at most `most` evaluations of the residuals."""
        return least_squares(self.residual, x, self.jacobian, method="lm", max_nfev=most, xtol=xtol, ftol=ftol)

    def torque(self, x: Array, index: int, n: int) -> Array:
        """Return block means of the torque of element n's bristles, Nm, and of the part due to c0, shape (b, 2)."""
        own, start = x[self.places[n]], np.clip(self.starts(x)[index, n], -self.max_start, self.max_start)
        both = self.motions[index].traces[n].bristles(self.kind(own, n), _exp(own[0]), float(start))
        return np.column_stack([both @ (1.0, self._c1(own, n)), both[:, 0]])

    def friction(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        motion = self.motions[index]
        total = [self.torque(x, index, n)[:, 0] + trace.viscous for n, trace in enumerate(motion.traces)]
        return np.column_stack(total) @ motion.inputs

    def kind(self, own: Array, n: int) -> BristlesPart | None:
        """Return the bristles of element n by its parameters; None for LuGre's."""
        return self.families[n].bristles(own[2:], self.motions[0].traces[n].element.tau_c_positive)

    def _prior_sd(self, x: Array) -> Array:
        place = self.inertial
        return np.repeat([INERTIA_SD, self.start_sd], [place.stop - place.start, x.size - place.stop])

    def _c1(self, own: Array, n: int) -> float:
        return _exp(own[1]) if self.unit is None else float(own[1] * self.unit[n])

    def _spectra(self, own: Array, n: int, index: int, start: float) -> Array:
        clipped = float(np.clip(start, -self.max_start, self.max_start))
        return self.motions[index].traces[n].spectra(self.kind(own, n), _exp(own[0]), clipped)

    def _slopes(self, x: Array, index: int) -> Array:
        """Return the derivatives of a motion's torques by the parameters, Nm, shape (r, k, parameters)."""
        motion, found = self.motions[index], np.zeros((*self.motions[index].target.shape, x.size))
        stiffer = np.log1p(_PARAMETER_STEP) if self.unit is None else _PARAMETER_STEP
        for n, (place, start) in enumerate(zip(self.places, self.starts(x)[index], strict=True)):
            own = x[place]
            c1, row, here = self._c1(own, n), motion.inputs[n], self._spectra(own, n, index, start)
            steps = np.diag(np.r_[stiffer, 0.0, np.full(own.size - 2, _PARAMETER_STEP)])
            changed = [(own + step, start) for k, step in enumerate(steps) if k != 1]
            by_stiffness, *by_shape, by_start = (
                (self._spectra(each, n, index, at) - here) @ (1.0, c1) / _PARAMETER_STEP
                for each, at in [*changed, (own, start + _PARAMETER_STEP)]
            )
            by_damping = here[:, 1] * (c1 if self.unit is None else self.unit[n])
            found[:, :, place] = np.column_stack([by_stiffness, by_damping, *by_shape])[:, None, :] * row[:, None]
            found[:, :, self.inertial.stop + index * len(self.families) + n] = np.outer(by_start, row)
        found[:, :, self.inertial] = motion.inertial
        return found


def _exp(logarithm: float) -> float:
    return float(np.exp(np.clip(logarithm, -20.0, 25.0)))


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
    matrix = arm.element_matrix
    shared = np.abs(matrix).T @ np.abs(matrix)
    _, group = connected_components(shared, directed=False)
    found = []
    for number in dict.fromkeys(group.tolist()):
        joints = np.flatnonzero(group == number)
        elements = np.flatnonzero(matrix[:, joints].any(axis=1))
        found.append(JointGroup(tuple(joints.tolist()), tuple(elements.tolist()), matrix[np.ix_(elements, joints)]))
    return found
