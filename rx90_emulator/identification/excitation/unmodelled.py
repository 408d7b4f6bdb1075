"""What the friction model leaves out, and what the deviations of its parameters owe to that.

**Rises and bristle damping** that the runs neither show nor exclude. A rise near the least speeds bends the curve the
other way than an exponent below 1, and lifts what looks like Coulomb friction. Where cross-validation did not keep one,
a rise of some size may still be there: covariances are then those of the model in which it lies anywhere from 0 on.
Static torque below Coulomb torque is no friction, and more than twice the Coulomb torque is assumed not to occur; fits
know nothing of either and may say -125 % with a deviation of 197 %. A bristle without its damping c1 takes the torque
of the damping for its own, which is in the same rows: it comes out stiffer by 5 to 10 %. Each bristle whose damping was
not kept may have one of any size from 0 on. So may viscous friction whose best value is its bound 0.

**Torques at their bound 0.** No friction drives: tau_c and c2 are at least 0. What a fit without that bound would give
says why nothing is left of them: friction that falls with speed, a torque that does not oppose the motion, or noise.
**Load.** Gears press harder on their bearings and teeth the more torque they carry. A model without that gives Coulomb
torques at the usual load of the runs; how far they are from those without load belongs into their deviations. One
coefficient for all elements, relative to their Coulomb torques, is tested: the runs tell it far better than one each.

**Sharpness of the recorded motion.** Presliding is over within milliseconds of a reversal, and a Stribeck rise within
some hundredths of rad/s. The filter of the positions and the sampling blur the motion there, alike at each reversal: no
residual tells of it. What the values shift when the motion is known less sharply still (at half the bandwidth, over
five samples, with every second sample) is of the size of what the first blur has shifted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.choice import PartKey, Selection, candidates
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.fit import Key, SeparableFit, WeightedProblem, best_start
from rx90_emulator.identification.excitation.law import COULOMB, LINEAR, VISCOUS, Part, joint_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.problem import Prior

_RELEVANT_SIZE = {Part.STRIBECK: 0.2, Part.DAMPING: 0.0, "c2": 0.0}  # of tau_c, Nm s/rad: what matters
_UPPER_SE = 2.0  # deviations
_MAX_SIZE = {Part.STRIBECK: 1.0, Part.DAMPING: math.inf, "c2": math.inf}  # of tau_c, Nm s/rad: none is larger (assumed)


def undecided_parts(
    selected: Selection, columns: Array, prior: Prior | None = None
) -> tuple[dict[int, tuple[float, float]], Array | None]:
    """Return rises, bristle damping and viscous friction that may be there, though they were not kept or are 0.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        prior: of the first parameters.

    Returns:
        Value and standard deviation of rises over tau_c, as fitted without bounds, by element; and the covariance of
        the q parameters with all of these within their bounds, shape (q, q), if there are any.
    """
    table: dict[PartKey | tuple[int, str], Array] = {}
    for e, part in sorted(selected.refused, key=lambda key: (key[1].value, key[0])):
        there = selected.fit.shapes[e].parts
        beside = part is Part.STRIBECK or (part is Part.DAMPING and Part.BRISTLE in there)
        if beside and part not in there and selected.fit.linear[e, COULOMB] > 0.0:
            table[e, part] = _column(selected, e, part)
    for e, (tau_c, c2, _) in enumerate(selected.fit.linear.tolist()):
        if c2 <= 0.0 < tau_c:
            table[e, "c2"] = _linear_column(selected, (e, "c2"))
    while table:
        wide, q = (
            solve(selected.weighted.problem, np.column_stack([columns, *table.values()]), prior=prior),
            columns.shape[1],
        )
        sizes = list(zip(wide.value[q:].tolist(), wide.deviation[q:].tolist(), strict=True))
        kept = {key: column for (key, column), (value, deviation) in zip(table.items(), sizes, strict=True)
                if value + _UPPER_SE * deviation > _RELEVANT_SIZE[key[1]] and math.isfinite(deviation)}  # fmt: skip
        if len(kept) == len(table):
            bounded = bounded_covariance(wide.covariance, sizes, [_MAX_SIZE[part] for _, part in table])
            found = zip(table, sizes, strict=True)
            return {e: size for (e, part), size in found if part is Part.STRIBECK}, bounded
        table = kept
    return {}, None


def bounded_covariance(covariance: Array, sizes: Sequence[tuple[float, float]], largest: Sequence[float]) -> Array:
    """Return the covariance of all but the last parameters, where these lie between 0 and `largest`.

    The values hold for sizes of 0: what one shifts is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between sizes stay.

    Args:
        covariance: of q + k parameters.
        sizes: values and standard deviations of the last k.
        largest: upper bounds of these.
    """
    count = len(covariance) - len(sizes)
    between = covariance[count:, count:]
    if not np.isfinite(between).all():
        return np.asarray(covariance[:count, :count])
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    factor = np.array([
        np.sqrt(truncnorm(-value / deviation, (most - value) / deviation, value, deviation).moment(2)) / deviation
        for (value, deviation), most in zip(sizes, largest, strict=True)
    ])  # fmt: skip
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


def _column(selected: Selection, element: int, part: Part) -> Array:
    """Return the torque per unit of an element's part, a rise with the Stribeck velocity that suits it, shape (r,)."""
    weighted, shapes = selected.weighted, list(selected.fit.shapes)
    begun = replace(shapes[element], parts=shapes[element].parts | {part})
    if part is Part.STRIBECK:
        begun = replace(begun, fixed=begun.fixed | {"omega_s", "delta"})
        begun = best_start(weighted, shapes, element, candidates(weighted, begun, element, part))
    shapes[element] = begun
    key = (element, "rise" if part is Part.STRIBECK else "c1")
    return weighted.column(shapes, selected.fit.linear, key) / weighted.weight


def _linear_column(selected: Selection, key: Key) -> Array:
    """Return the torque per unit of an element's linear parameter, shape (r,)."""
    weighted = selected.weighted
    return weighted.column(selected.fit.shapes, selected.fit.linear, key) / weighted.weight


class Unbounded(NamedTuple):
    """What a fit says of parameters that are 0, their bound, when they may be less.

    Attributes:
        sizes: value and standard deviation of each that the runs determine.
        shift: what the parameters of the model shift where friction falls with speed, shape (q,).
        remarks: on which elements it does, and what that does to their tau_c.
    """

    sizes: dict[Key, tuple[float, float]]
    shift: Array
    remarks: tuple[str, ...]


def without_bounds(selected: Selection, columns: Array, without: LinearFit, prior: Prior | None = None) -> Unbounded:
    """Fit once more with tau_c and c2 free where they came out as 0.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.
    """
    problem, fit, q = selected.weighted.problem, selected.fit, columns.shape[1]
    bound = [
        (e, LINEAR[place])
        for e, rows in enumerate(selected.weighted.elements)
        for place in (COULOMB, VISCOUS)
        if len(rows.rows) and fit.linear[e, place] <= 0.0
    ]
    shift, sizes, remarks = np.zeros(q), {}, []
    if bound:
        added = [_linear_column(selected, key) for key in bound]
        wide = solve(problem, np.column_stack([columns, *added]), prior=prior)
        pairs = zip(bound, wide.value[q:].tolist(), wide.deviation[q:].tolist(), wide.determined[q:], strict=True)
        sizes = {key: (value, deviation) for key, value, deviation, known in pairs if known}
        falling = [e for e, name in sizes if name == "c2" and (e, "tau_c") not in sizes and _negative(*sizes[e, name])]
        if falling:
            one = solve(
                problem,
                np.column_stack([columns, *(_linear_column(selected, (e, "c2")) for e in falling)]),
                prior=prior,
            )
            shift = np.where(one.determined[:q] & without.determined, one.value[:q] - without.value, 0.0)
            first, inner = len(problem.names), fit.inner()
            for k, e in enumerate(falling):
                place, name = first + inner.index((e, "tau_c")), problem.arm.element_names[e]
                low, high = selected.weighted.elements[e].speed_range
                remarks.append(
                    f"the friction of {name} falls with speed, and c2 is at its bound 0: without it c2 would be "
                    f"{one.value[q + k]:.3g} +- {one.deviation[q + k]:.2g} Nm s/rad and tau_c {one.value[place]:.3g} "
                    f"in place of {without.value[place]:.3g} Nm. tau_c is a mean over the speeds from {low:.2g} to "
                    f"{high:.2g} rad/s, too small at slow ones and too large at fast ones; its deviation contains the "
                    "difference"
                )
    return Unbounded(sizes, shift, tuple(remarks))


def _negative(value: float, deviation: float) -> bool:
    """Return whether a value is below 0 by more than chance."""
    return value < -_UPPER_SE * deviation


_MIN_LOAD = 1e-6  # Nm, of a load that elements' friction is compared with
_LOAD_SE = 2.0  # deviations of the coefficient from 0


def load_dependence(
    selected: Selection, columns: Array, without: LinearFit, prior: Prior | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Test whether friction grows with the load.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.

    Returns:
        What the parameters shift when it is admitted, shape (q,), 0 where the runs do not show it; and a remark where
        they do.
    """
    problem, fit = selected.weighted.problem, selected.fit
    bare = np.abs(problem.regressor @ without.value[: len(problem.names)])
    coulomb = joint_columns(problem, fit.shapes)[:, :, COULOMB] * fit.linear[:, COULOMB]
    column = np.zeros(len(bare))
    for e in range(len(fit.shapes)):
        own = problem.joint == np.flatnonzero(problem.arm.element_matrix[e])[-1]
        if own.any():
            # A coupled element carries the torque of the last joint that it acts on, on the rows of all of them.
            load = np.full(problem.sample.max() + 1, float(np.mean(bare[own])))
            load[problem.sample[own]] = bare[own]
            column += coulomb[:, e] * load[problem.sample] / max(float(np.sqrt(np.mean(bare[own] ** 2))), _MIN_LOAD)
    wide = solve(problem, np.column_stack([columns, column]), prior=prior)
    value, deviation = float(wide.value[-1]), float(wide.deviation[-1])
    shift = wide.value[:-1] - without.value
    if abs(value) <= _LOAD_SE * deviation:
        return np.zeros_like(shift), ()
    size = f"{100.0 * value:.2g} % with a standard deviation of {100.0 * deviation:.2g} %"
    return shift, (
        f"Coulomb friction changes with the load, at a joint's RMS torque by {size}: tau_c holds at the usual load of "
        "the runs, and its deviation contains the difference to no load",
    )


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
    sharp = joint_columns(problem, fit.shapes)
    size = np.linalg.norm(columns * weighted.weight[:, None], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    tangent = columns * weighted.weight[:, None] / scale
    shifts = []
    blurs: list[Callable[[Array, FilteredRun], Array]] = [
        lambda values, run: run.smooth(values, _BLURRED_BANDWIDTH_SHARE * run.bandwidths.position),
        lambda values, _: np.asarray(uniform_filter1d(values, _AVERAGED_SAMPLES, axis=0)),
        _every_second,
    ]
    for blur in blurs:
        other = replace(problem, runs=tuple(_blurred(run, blur) for run in problem.runs))
        lost = np.tensordot(sharp - joint_columns(other, fit.shapes), fit.linear, 2)
        shifts.append(np.asarray(np.linalg.lstsq(tangent, lost * weighted.weight, rcond=1e-8)[0] / scale))
    return shifts


def _blurred(run: FilteredRun, blur: Callable[[Array, FilteredRun], Array]) -> FilteredRun:
    """Return a run with other positions and velocities; stamps of the torque are as far apart as samples."""
    stamps = None if run.stamps is None else run.stamps._replace(velocity=blur(run.stamps.velocity, run))
    return replace(run, position=blur(run.position, run), velocity=blur(run.velocity, run), stamps=stamps)


def _every_second(values: Array, _: FilteredRun) -> Array:
    """Return values whose every second one is the mean of its neighbours, shape (m, n)."""
    result = values.copy()
    between = result[1:-1:2]
    between[:] = 0.5 * (result[:-2:2] + result[2::2])
    return result
