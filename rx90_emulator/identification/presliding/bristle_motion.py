"""Micro-motions with LuGre's bristles: the predicted torques in the band of micro-oscillations.

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
from typing import Final

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.presliding.micro_motion import BLOCK, MicroMotion, band_spectrum
from rx90_emulator.identification.records import block_means

INERTIA_SD: Final = 0.05
"""Prior standard deviation of the errors of the mass matrix, in units of sqrt(M_jj M_ii)."""
_CACHED_SPECTRA = 16  # of a motion: difference quotients use the same start deflection again
_START_SD = 0.3  # prior standard deviation of a start deflection, in units of that of steady sliding
_PARAMETER_STEP = 1e-4  # step of difference quotients, for parameters of the order of 1


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
    """

    element: FrictionElement
    speed: Array
    viscous: Array
    step: float

    @classmethod
    def of(cls, element: FrictionElement, speed: Array, step: float) -> ElementTrace:
        """Return the trace of an element, c0 and c1 of which are not used, at input velocities in a record's steps."""
        plain = element.without_parts().replaced(c1=1.0, c2=0.0)
        viscous = block_means(element.viscous_torque(speed), BLOCK)
        return cls(plain, speed[: len(viscous) * BLOCK], viscous, step)

    @cached_property
    def spectra(self) -> Callable[[float, float], Array]:
        """Return a function for the spectra of the results of `bristles`, shape (r, 2), with a cache."""
        return lru_cache(_CACHED_SPECTRA)(lambda *bristle: self.spectrum(self.bristles(*bristle)))

    def spectrum(self, means: Array) -> Array:
        """Return the spectrum of block means, shape (b, c) to (r, c)."""
        return band_spectrum(means, self.step)[0]

    def bristles(self, c0: float, start: float) -> Array:
        """Return block means of the bristles' torque, Nm, and of the rate that c1 multiplies, rad/s, shape (b, 2).

        Args:
            c0: Nm/rad.
            start: deflection at the beginning over that of steady sliding.
        """
        first = start * self.element.tau_c.positive / c0
        found = np.empty((len(self.speed), 2))
        _deflect_lugre(self.speed, self._sliding_torque, self.step, c0, first, found)
        found[:, 1] *= self._fading
        return block_means(found, BLOCK)

    @cached_property
    def _sliding_torque(self) -> Array:
        return self.element.sliding_torque(self.speed)

    @cached_property
    def _fading(self) -> Array:
        return self.element.damping(self.speed)


@dataclass(frozen=True, eq=False)
class GroupMotion:
    """A micro-motion of k joints with e friction elements, in the band.

    Attributes:
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        traces: of the elements.
        target: spectrum of the bristles' torque at the joints, drive less weight, inertia and viscous torque, Nm, shape
            (r, k).
        inertial: those of errors of the inertia, one for each pair of joints, in units of sqrt(M_jj M_ii), Nm, shape
            (r, k, p). Errors of the other joints' inertia, which hardly move, are neglected.
        line: frequency of each of the r rows, Hz, rounded.
    """

    inputs: Array
    traces: tuple[ElementTrace, ...]
    target: Array
    inertial: Array
    line: Array

    @classmethod
    def of(cls, motion: MicroMotion, inputs: Array, sliding: Sequence[FrictionElement]) -> GroupMotion:
        """Return a micro-motion of a group.

        Args:
            motion: of the group's joints.
            inputs: as the attribute.
            sliding: the elements' sliding regime; c0 and c1 are not used.
        """
        speed = motion.velocity @ inputs.T
        acceleration = motion.acceleration[:, list(motion.joints)]
        traces = tuple(ElementTrace.of(one, speed[:, n], motion.step) for n, one in enumerate(sliding))
        torques = [motion.friction]
        scale = motion.inertia_scale
        for j, i in zip(*np.triu_indices(len(scale)), strict=True):
            torques.append(np.zeros_like(torques[0]))
            torques[-1][:, j] = scale[j, i] * acceleration[:, i]
            torques[-1][:, i] = scale[j, i] * acceleration[:, j]
        measured = block_means(np.stack(torques, axis=2), BLOCK)
        measured[:, :, 0] -= np.column_stack([trace.viscous for trace in traces]) @ inputs
        spectrum, frequency = band_spectrum(measured.reshape(len(measured), -1), motion.step)
        spectrum = spectrum.reshape(-1, *measured.shape[1:])
        return cls(inputs, traces, spectrum[:, :, 0], spectrum[:, :, 1:], np.round(frequency))

    def changed(self, n: int, element: FrictionElement, speed: Array | None = None) -> GroupMotion:
        """Return the motion with another sliding regime, and other velocities if given, of element n."""
        before = self.traces[n]
        trace = ElementTrace.of(element, before.speed if speed is None else speed, before.step)
        more = np.outer(trace.viscous - before.viscous, self.inputs[n])
        traces = (*self.traces[:n], trace, *self.traces[n + 1 :])
        return replace(self, traces=traces, target=self.target - trace.spectrum(more))


@dataclass(frozen=True, eq=False)
class GroupModel:
    """Residuals of M motions for LuGre's bristles of a group's e elements, as a function of parameters x.

    x contains ln c0 and ln c1, element by element; then the errors of the inertia, in units of sqrt(M_jj M_ii); then
    the start deflections in units of those of steady sliding, motion by motion. All micro-oscillations are made at one
    pose, so errors of the links' description are a constant error of the inertia.

    Attributes:
        motions: M of them.
        scale: unit of the residuals, Nm, shape (k,).
    """

    motions: tuple[GroupMotion, ...]
    scale: Array

    @property
    def elements(self) -> int:
        """Return the number of the group's elements."""
        return len(self.motions[0].traces)

    @property
    def inertial(self) -> slice:
        """Return the slice of the errors of the inertia: behind the elements', before the start deflections."""
        first = 2 * self.elements
        return slice(first, first + int(self.motions[0].inertial.shape[2]))

    def starts(self, x: Array) -> Array:
        """Return the start deflections of the motions, in parts of those of steady sliding, shape (M, e)."""
        return x[self.inertial.stop :].reshape(-1, self.elements)

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.exp(np.clip(x[: self.inertial.start], -20.0, 25.0)).reshape(-1, 2)

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the residual spectrum of a motion in units of the scale, shape (r, k)."""
        motion = self.motions[index]
        residual = motion.target - motion.inertial @ x[self.inertial]
        for n, ((c0, c1), start) in enumerate(zip(self.values(x), self.starts(x)[index], strict=True)):
            torque = motion.traces[n].spectra(float(c0), float(start)) @ (1.0, c1)
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
        c0, c1 = self.values(x)[n]
        both = self.motions[index].traces[n].bristles(float(c0), float(self.starts(x)[index, n]))
        return np.column_stack([both @ (1.0, c1), both[:, 0]])

    def friction(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        motion = self.motions[index]
        total = [self.torque(x, index, n)[:, 0] + trace.viscous for n, trace in enumerate(motion.traces)]
        return np.column_stack(total) @ motion.inputs

    def _prior_sd(self, x: Array) -> Array:
        place = self.inertial
        return np.repeat([INERTIA_SD, _START_SD], [place.stop - place.start, x.size - place.stop])

    def _slopes(self, x: Array, index: int) -> Array:
        """Return the derivatives of a motion's torques by the parameters, Nm, shape (r, k, parameters)."""
        motion = self.motions[index]
        slopes = np.zeros((*motion.target.shape, x.size))
        first_start = self.inertial.stop + index * self.elements
        starts = self.starts(x)[index].tolist()
        for n, ((c0, c1), start) in enumerate(zip(self.values(x).tolist(), starts, strict=True)):
            trace = motion.traces[n]
            row = motion.inputs[n]
            here = trace.spectra(c0, start)
            stiffer = trace.spectra(c0 * (1.0 + _PARAMETER_STEP), start)
            deflected = trace.spectra(c0, start + _PARAMETER_STEP)
            by_stiffness = (stiffer - here) @ (1.0, c1) / _PARAMETER_STEP
            by_start = (deflected - here) @ (1.0, c1) / _PARAMETER_STEP
            slopes[:, :, 2 * n] = np.outer(by_stiffness, row)
            slopes[:, :, 2 * n + 1] = np.outer(c1 * here[:, 1], row)
            slopes[:, :, first_start + n] = np.outer(by_start, row)
        slopes[:, :, self.inertial] = motion.inertial
        return slopes
