"""How much of friction near rest owes to the sharpness of the recorded motion.

Presliding is over within milliseconds of a reversal, and a Stribeck rise within some hundredths of rad/s. The filter of
the positions and the sampling blur the motion there, alike at each reversal: no residual tells of it. What the values
shift when the motion is known less sharply still (at half the bandwidth, over five samples, with every second sample)
is of the size of what the first blur has shifted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.friction.columns import ElementRows, element_rows
from rx90_emulator.identification.excitation.friction.law import Part
from rx90_emulator.identification.excitation.friction.separable import SeparableFit
from rx90_emulator.identification.excitation.friction.weighted import WeightedProblem

_NARROWER = 0.5  # bandwidth over that of the positions
_SAMPLES = 5


def blur_shifts(weighted: WeightedProblem, fit: SeparableFit, columns: Array) -> list[Array]:
    """Return what all parameters shift with a motion that is known less sharply, arrays of shape (q,).

    Friction without rise and bristle knows of a reversal's time alone, which no blur moves: then there is none.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around it, shape (r, q).
    """
    if not any({Part.STRIBECK, Part.BRISTLE} & shape.parts for shape in fit.shapes):
        return []
    problem = weighted.problem
    sharp = _torque(fit, weighted.elements)
    size = np.linalg.norm(columns * weighted.weight[:, None], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    tangent = columns * weighted.weight[:, None] / scale
    shifts = []
    for blurred in (_narrower, _averaged, _halved):
        other = replace(problem, runs=tuple(blurred(run) for run in problem.runs))
        lost = sharp - _torque(fit, element_rows(other))
        shifts.append(np.asarray(np.linalg.lstsq(tangent, lost * weighted.weight, rcond=1e-8)[0] / scale))
    return shifts


def _torque(fit: SeparableFit, elements: Sequence[ElementRows]) -> Array:
    """Return the friction torque at the rows, Nm, shape (r,)."""
    torque = np.zeros(len(elements[0].problem))
    for rows, shape, linear in zip(elements, fit.shapes, fit.linear, strict=True):
        torque[rows.rows] += rows.columns(shape)[0] @ linear
    return torque


def _narrower(run: FilteredRun) -> FilteredRun:
    sections = butter(4, _NARROWER * run.bandwidths.position, fs=run.rate, output="sos")
    return _changed(run, lambda values: np.asarray(sosfiltfilt(sections, values, axis=0)))


def _averaged(run: FilteredRun) -> FilteredRun:
    return _changed(run, lambda values: np.asarray(uniform_filter1d(values, _SAMPLES, axis=0)))


def _halved(run: FilteredRun) -> FilteredRun:
    return _changed(run, _every_second)


def _every_second(values: Array) -> Array:
    """Return values whose every second one is the mean of its neighbours, shape (m, n)."""
    result = values.copy()
    between = result[1:-1:2]
    between[:] = 0.5 * (result[:-2:2] + result[2::2])
    return result


def _changed(run: FilteredRun, change: Callable[[Array], Array]) -> FilteredRun:
    """Return a run with other positions and velocities; stamps of the torque are as far apart as samples."""
    stamps = None if run.stamps is None else replace(run.stamps, velocity=change(run.stamps.velocity))
    return replace(run, position=change(run.position), velocity=change(run.velocity), stamps=stamps)
