"""What the friction model leaves out, and what the deviations of its parameters owe to that.

Rises and bristle damping that the runs neither show nor exclude: what other parameters' deviations owe to them.

A rise near the least speeds bends the curve the other way than an exponent below 1, and lifts what looks like Coulomb
friction. Where cross-validation did not keep one, a rise of some size may still be there: covariances are then those
of the model in which it lies anywhere from 0 on. Static torque below Coulomb torque is no friction, and more than twice
the Coulomb torque is assumed not to occur; fits know nothing of either and may say -125 % with a deviation of 197 %.

A bristle without its damping c1 takes the torque of the damping for its own, which is in the same rows: it comes out
stiffer by 5 to 10 %. Each bristle whose damping was not kept may have one of any size from 0 on.

Friction that grows with the load, which the friction elements do not have: how much of it shows, and what it shifts.

Gears press harder on their bearings and teeth the more torque they carry. A model without that gives Coulomb torques at
the usual load of the runs; how far they are from those without load belongs into their deviations. One coefficient
for all elements, relative to their Coulomb torques, is tested: the runs tell it far better than one for each.

How much of friction near rest owes to the sharpness of the recorded motion.

Presliding is over within milliseconds of a reversal, and a Stribeck rise within some hundredths of rad/s. The filter of
the positions and the sampling blur the motion there, alike at each reversal: no residual tells of it. What the values
shift when the motion is known less sharply still (at half the bandwidth, over five samples, with every second sample)
is of the size of what the first blur has shifted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.friction.fit import SeparableFit, WeightedProblem, best_start
from rx90_emulator.identification.excitation.friction.law import COULOMB, ElementRows, ElementShape, Part, element_rows
from rx90_emulator.identification.excitation.friction.selection import Key, Selected, candidates
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.linear_parameters import Prior

_RELEVANT_SIZE = {Part.STRIBECK: 0.2, Part.DAMPING: 0.0}  # of tau_c, Nm s/rad: what matters
_UPPER_SE = 2.0  # deviations
_MAX_SIZE = {Part.STRIBECK: 1.0, Part.DAMPING: math.inf}  # of tau_c, Nm s/rad: none is larger (assumed)


def undecided_parts(
    selected: Selected, columns: Array, prior: Prior | None = None
) -> tuple[dict[Key, tuple[float, float]], Array | None]:
    """Return rises and bristle damping that may be there, though they were not kept.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        prior: of the first parameters.

    Returns:
        Value and standard deviation by element and part, as fitted without bounds, of rises over tau_c, of damping in
        Nm s/rad; and the covariance of the q parameters with these parts within their bounds, shape (q, q), if there
        are any.
    """
    weighted, fit = selected.weighted, selected.fit
    table = {}
    for e, part in sorted(selected.refused, key=lambda key: (key[1].value, key[0])):
        shape = fit.shapes[e]
        beside = part is Part.STRIBECK or (part is Part.DAMPING and Part.BRISTLE in shape.parts)
        if beside and part not in shape.parts and fit.linear[e, COULOMB] > 0.0:
            table[e, part] = _column(weighted, fit.shapes, fit.linear, e, part)
    while table:
        wide = solve(weighted.problem, np.column_stack([columns, *table.values()]), prior=prior)
        found = _sizes(wide, tuple(table))
        kept = {key: table[key] for key, (value, deviation) in found.items()
                if value + _UPPER_SE * deviation > _RELEVANT_SIZE[key[1]]}  # fmt: skip
        if len(kept) == len(table):
            largest = [_MAX_SIZE[part] for _, part in found]
            return found, _bounded(wide.covariance, list(found.values()), largest)
        table = kept
    return {}, None


def _sizes(fit: LinearFit, keys: Sequence[Key]) -> dict[Key, tuple[float, float]]:
    """Return the last values of a fit with their deviations, one for each part."""
    values, deviations = (part[len(part) - len(keys) :].tolist() for part in (fit.value, fit.deviation))
    return dict(zip(keys, zip(values, deviations, strict=True), strict=True))


def _bounded(covariance: Array, sizes: Sequence[tuple[float, float]], largest: Sequence[float]) -> Array:
    """Return the covariance of all but the last parameters, where these lie between 0 and `largest`.

    The values hold for sizes of 0: what one shifts is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between sizes stay.
    """
    count = len(covariance) - len(sizes)
    between = covariance[count:, count:]
    if not np.isfinite(between).all():
        return np.asarray(covariance[:count, :count])
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    pairs = zip(sizes, largest, strict=True)
    factor = np.array([_size_within(value, deviation, most) / deviation for (value, deviation), most in pairs])
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


def _size_within(value: float, deviation: float, most: float) -> float:
    """Return the root mean square of a normal variable that lies between 0 and `most`."""
    inside = truncnorm(-value / deviation, (most - value) / deviation, value, deviation)
    return float(np.sqrt(inside.moment(2)))


def _column(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], linear: Array, element: int, part: Part
) -> Array:
    """Return the torque per unit of an element's part, a rise with the Stribeck velocity that suits it, shape (r,)."""
    begun = replace(shapes[element], parts=shapes[element].parts | {part})
    if part is Part.STRIBECK:
        begun = replace(begun, fixed=begun.fixed | {"omega_s", "delta"})
        begun = best_start(weighted, shapes, element, candidates(weighted, begun, element, part))
    there = [*shapes[:element], begun, *shapes[element + 1 :]]
    return weighted.column(there, linear, element, "rise" if part is Part.STRIBECK else "c1") / weighted.weight


_MIN_LOAD = 1e-6  # Nm, of a load that elements' friction is compared with
_LOAD_SE = 2.0  # deviations of the coefficient from 0


class LoadDependence(NamedTuple):
    """How Coulomb friction grows with the load.

    Attributes:
        value: relative growth at a joint's RMS torque without friction.
        deviation: its standard deviation.
        shift: of all parameters when it is admitted; 0 where it is not significant, shape (q,).
    """

    value: float
    deviation: float
    shift: Array

    @property
    def significant(self) -> bool:
        """Return whether the runs show it."""
        return abs(self.value) > _LOAD_SE * self.deviation


def load_dependence(
    weighted: WeightedProblem, fit: SeparableFit, columns: Array, without: LinearFit, prior: Prior | None = None
) -> LoadDependence:
    """Test whether friction grows with the load.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around the fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.
    """
    problem = weighted.problem
    bare = np.abs(problem.regressor @ without.value[: len(problem.names)])
    wide = solve(problem, np.column_stack([columns, _load_column(weighted, fit, bare)]), prior=prior)
    value, deviation = float(wide.value[-1]), float(wide.deviation[-1])
    found = LoadDependence(value, deviation, wide.value[:-1] - without.value)
    return found if found.significant else found._replace(shift=np.zeros_like(found.shift))


def _load_column(weighted: WeightedProblem, fit: SeparableFit, bare: Array) -> Array:
    """Return Coulomb torques times the load over its RMS, Nm, shape (r,).

    Args:
        weighted: the rows.
        fit: of the friction.
        bare: size of each row's torque without friction, Nm, shape (r,).
    """
    problem, column = weighted.problem, np.zeros(len(bare))
    samples = max(len(run.rows) for run in problem.runs)
    for e, (rows, shape) in enumerate(zip(weighted.elements, fit.shapes, strict=True)):
        joint = int(np.flatnonzero(problem.arm.element_matrix[e])[-1])
        own = problem.joint == joint
        if not own.any():
            continue
        # A coupled element carries the torque of the last joint that it acts on, on the rows of all of them.
        table = np.full(len(problem.runs) * samples, float(np.mean(bare[own])))
        table[problem.run[own] * samples + problem.place[own]] = bare[own]
        load = table[problem.run[rows.rows] * samples + problem.place[rows.rows]]
        size = max(float(np.sqrt(np.mean(bare[own] ** 2))), _MIN_LOAD)
        column[rows.rows] += rows.columns(shape)[0][:, COULOMB] * fit.linear[e, COULOMB] * load / size
    return column


_BLURRED_BANDWIDTH_SHARE = 0.5  # bandwidth over that of the positions
_AVERAGED_SAMPLES = 5


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
    sharp = _friction_torque(fit, weighted.elements)
    size = np.linalg.norm(columns * weighted.weight[:, None], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    tangent = columns * weighted.weight[:, None] / scale
    shifts = []
    for blurred in (_narrower, _averaged, _halved):
        other = replace(problem, runs=tuple(blurred(run) for run in problem.runs))
        lost = sharp - _friction_torque(fit, element_rows(other))
        shifts.append(np.asarray(np.linalg.lstsq(tangent, lost * weighted.weight, rcond=1e-8)[0] / scale))
    return shifts


def _friction_torque(fit: SeparableFit, elements: Sequence[ElementRows]) -> Array:
    """Return the friction torque at the rows, Nm, shape (r,)."""
    torque = np.zeros(len(elements[0].problem))
    for rows, shape, linear in zip(elements, fit.shapes, fit.linear, strict=True):
        torque[rows.rows] += rows.columns(shape)[0] @ linear
    return torque


def _narrower(run: FilteredRun) -> FilteredRun:
    sections = butter(4, _BLURRED_BANDWIDTH_SHARE * run.bandwidths.position, fs=run.rate, output="sos")
    return _changed(run, lambda values: np.asarray(sosfiltfilt(sections, values, axis=0)))


def _averaged(run: FilteredRun) -> FilteredRun:
    return _changed(run, lambda values: np.asarray(uniform_filter1d(values, _AVERAGED_SAMPLES, axis=0)))


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
