"""The effect of neglected friction on the parameters, and its contribution to their deviations.

**Rises and bristle damping** that the runs neither show nor exclude. A rise near the least speeds bends the curve in
the opposite direction to an exponent below 1, and increases the apparent Coulomb friction. Where cross-validation did
not keep a rise, one of some size may still exist: covariances are then those of a model whose rise lies anywhere from 0
on. Static torque below Coulomb torque is no friction, and more than twice the Coulomb torque is assumed not to occur;
an unbounded fit may give -125 % with a deviation of 197 %. A bristle without its damping c1 takes over the damping's
torque, which acts in the same rows: it comes out stiffer by 5 to 10 %. Each bristle whose damping was not kept may have
a damping of any size from 0 on. The same holds for viscous friction whose best value is its bound 0.

**Torques at their bound 0.** Friction does not drive: tau_c and c2 are at least 0. A fit without that bound shows why a
value ends there: friction that falls with speed, a torque that does not oppose the motion, or noise.

**Load.** Gears press harder on their bearings and teeth the more torque they carry. A model without this effect gives
Coulomb torques at the usual load of the runs; their difference from those without load belongs into their deviations.
One coefficient for all elements, relative to their Coulomb torques, is tested, because the runs determine it far better
than one for each.

**Resolution of the recorded motion.** Presliding ends within milliseconds of a reversal, and a Stribeck rise within
some hundredths of rad/s. The filter of the positions and the sampling smooth the motion there, in the same way at each
reversal, so residuals do not show it. The shift of the values with a motion that is smoothed once more (half the
bandwidth, averages over five samples, every second sample) has the size of the shift by the first smoothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.choice import PartKey, Selection, candidates
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.fit import Key, LinearFit, SeparableFit, WeightedProblem, best_start, solve
from rx90_emulator.identification.excitation.law import COULOMB, LINEAR, VISCOUS, Part, joint_columns
from rx90_emulator.identification.excitation.problem import Prior

_RELEVANT_SIZE = {Part.STRIBECK: 0.2, Part.DAMPING: 0.0, "c2": 0.0}  # of tau_c, Nm s/rad: least relevant size
_UPPER_SE = 2.0  # deviations
_MAX_SIZE = {Part.STRIBECK: 1.0, Part.DAMPING: math.inf, "c2": math.inf}  # of tau_c, Nm s/rad: largest size (assumed)
_MAX_EXPONENT_STEP = 0.8  # of an exponent from 1
_MIN_LOAD = 1e-6  # Nm, least load that friction is compared with


class FinalFit:
    """The fit of a whole model, linear around the selected one, with deviations that include neglected effects.

    Exponents that were tried and not kept stay at 1, but the covariance is that with free exponents, because excluding
    an exponent adds no information on tau_c and c2. The same holds for a Stribeck rise, or the damping of a bristle,
    that may exist. The shifts of the values by these exponents, by a growth of friction with the load, and by a motion
    that is smoothed once more, widen the covariance, too.

    Args:
        selected: the model.
        parts: of the friction, that were tried.
        prior: of the first parameters.

    Attributes:
        inner: the friction's parameters, which follow those of the base in the fit.
        fit: the fit.
        rises: value and standard deviation over tau_c of Stribeck rises that may exist, by element.
        unbounded: value and standard deviation of torques at their bound 0 in a fit without it, as far as the runs
            determine them.
        remarks: on a growth of friction with the load.
        warnings: on elements whose friction falls with speed, and the effect on their tau_c.
    """

    def __init__(self, selected: Selection, parts: Sequence[Part], prior: Prior | None = None) -> None:
        self._selected = selected
        self._prior = prior
        weighted = selected.weighted
        fit = selected.fit
        problem = weighted.problem
        inner = fit.inner()
        released = tuple(
            (e, "alpha")
            for e, shape in enumerate(fit.shapes)
            if Part.EXPONENT in parts and Part.EXPONENT not in shape.parts and fit.linear[e, VISCOUS] > 0.0
        )
        self.inner: tuple[Key, ...] = (*inner, *released)
        self.rises: dict[int, tuple[float, float]] = {}
        self.unbounded: dict[Key, tuple[float, float]] = {}
        self.remarks: list[str] = []
        self.warnings: list[str] = []
        self._columns = weighted.tangent(fit, self.inner)
        final = self._wide = solve(problem, self._columns, prior=prior)
        if released:
            bounded = solve(problem, self._columns[:, : -len(released)], prior=prior)
            value = np.append(bounded.value, np.zeros(len(released)))
            final = replace(final, value=value, residual=bounded.residual, sigma=bounded.sigma, weights=bounded.weights)
        exponent_shift = np.where(final.determined, self._wide.value - final.value, 0.0)
        # If an exponent would leave its range, the runs do not determine it: its shift has no meaning.
        steps = zip(released, exponent_shift[len(exponent_shift) - len(released) :].tolist(), strict=True)
        unstable = {e for (e, _), step in steps if abs(step) > _MAX_EXPONENT_STEP}
        if unstable:
            exponent_shift[: len(problem.names)] = 0.0
            exponent_shift[len(problem.names) + np.flatnonzero([e in unstable for e, _ in self.inner])] = 0.0
        covariance = self._with_undecided_parts()
        blur = blur_shifts(weighted, fit, self._columns)
        shifts = np.column_stack([self._load_dependence(), exponent_shift, self._without_bounds(), *blur])
        self.fit = replace(final, covariance=covariance + shifts @ shifts.T)

    def _augmented(self, *columns: Array) -> LinearFit:
        """Return the fit with further columns, each of shape (r,), behind those of the model."""
        problem = self._selected.weighted.problem
        return solve(problem, np.column_stack([self._columns, *columns]), prior=self._prior)

    def _column(self, element: int, part: Part | str) -> Array:
        """Return the torque per unit of a part, for a rise with the Stribeck velocity that fits best, shape (r,).

        A linear parameter is named by a string.
        """
        weighted = self._selected.weighted
        shapes = list(self._selected.fit.shapes)
        name = str(part)
        if isinstance(part, Part):
            name = "rise" if part is Part.STRIBECK else "c1"
            extended = replace(shapes[element], parts=shapes[element].parts | {part})
            if part is Part.STRIBECK:
                extended = replace(extended, fixed=extended.fixed | {"omega_s", "delta"})
                extended = best_start(weighted, shapes, element, candidates(weighted, extended, element, part))
            shapes[element] = extended
        return weighted.column(shapes, self._selected.fit.linear, (element, name)) / weighted.weight

    def _with_undecided_parts(self) -> Array:
        """Return the covariance with rises, damping and viscous friction that may exist though not kept, shape (q, q).

        All of these are limited to their bounds.
        """
        selected = self._selected
        q = self._columns.shape[1]
        table: dict[PartKey | Key, Array] = {}
        for e, part in sorted(selected.refused, key=lambda key: (key[1].value, key[0])):
            there = selected.fit.shapes[e].parts
            is_candidate = part is Part.STRIBECK or (part is Part.DAMPING and Part.BRISTLE in there)
            if is_candidate and part not in there and selected.fit.linear[e, COULOMB] > 0.0:
                table[e, part] = self._column(e, part)
        for e, (tau_c, c2, _) in enumerate(selected.fit.linear.tolist()):
            if c2 <= 0.0 < tau_c:
                table[e, "c2"] = self._column(e, "c2")
        while table:
            augmented = self._augmented(*table.values())
            sizes = list(zip(augmented.value[q:].tolist(), augmented.deviation[q:].tolist(), strict=True))
            small = {key: column for (key, column), (value, deviation) in zip(table.items(), sizes, strict=True)
                    if value + _UPPER_SE * deviation > _RELEVANT_SIZE[key[1]] and math.isfinite(deviation)}  # fmt: skip
            if len(small) == len(table):
                found = zip(table, sizes, strict=True)
                self.rises = {e: size for (e, part), size in found if part is Part.STRIBECK}
                return bounded_covariance(augmented.covariance, sizes, [_MAX_SIZE[part] for _, part in table])
            table = small
        return self._wide.covariance

    def _without_bounds(self) -> Array:
        """Return the shift of the parameters where friction falls with speed, if c2 may be negative, shape (q,).

        All tau_c and c2 that came out as 0 are fitted once more without that bound.
        """
        selected = self._selected
        q = self._columns.shape[1]
        problem = selected.weighted.problem
        fit = selected.fit
        unbounded_fit = self._wide
        bound = [
            (e, LINEAR[place])
            for e, rows in enumerate(selected.weighted.elements)
            for place in (COULOMB, VISCOUS)
            if len(rows.rows) and fit.linear[e, place] <= 0.0
        ]
        if not bound:
            return np.zeros(q)
        unrestricted = self._augmented(*(self._column(*key) for key in bound))
        pairs = zip(
            bound,
            unrestricted.value[q:].tolist(),
            unrestricted.deviation[q:].tolist(),
            unrestricted.determined[q:],
            strict=True,
        )
        self.unbounded = {key: (value, deviation) for key, value, deviation, known in pairs if known}
        negative = {key for key, (value, deviation) in self.unbounded.items() if value < -_UPPER_SE * deviation}
        falling = [
            e for e, name in bound if (e, "c2") in negative and name == "c2" and (e, "tau_c") not in self.unbounded
        ]
        if not falling:
            return np.zeros(q)
        one = self._augmented(*(self._column(e, "c2") for e in falling))
        for k, e in enumerate(falling):
            place = len(problem.names) + fit.inner().index((e, "tau_c"))
            name = problem.arm.element_names[e]
            low, high = selected.weighted.elements[e].speed_range
            self.warnings.append(
                f"the friction of {name} falls with speed, and c2 is at its bound 0: without it c2 would be "
                f"{one.value[q + k]:.3g} +- {one.deviation[q + k]:.2g} Nm s/rad and tau_c {one.value[place]:.3g} "
                f"in place of {unbounded_fit.value[place]:.3g} Nm. tau_c is a mean over the speeds from {low:.2g} to "
                f"{high:.2g} rad/s, too small at slow ones and too large at fast ones; its deviation contains the "
                "difference"
            )
        return np.where(one.determined[:q] & unbounded_fit.determined, one.value[:q] - unbounded_fit.value, 0.0)

    def _load_dependence(self) -> Array:
        """Return the shift of the parameters if friction may grow with the load, shape (q,); 0 where it does not."""
        problem = self._selected.weighted.problem
        fit = self._selected.fit
        unbounded_fit = self._wide
        bare = np.abs(problem.regressor @ unbounded_fit.value[: len(problem.names)])
        coulomb = joint_columns(problem, fit.shapes)[:, :, COULOMB] * fit.linear[:, COULOMB]
        column = np.zeros(len(bare))
        for e in range(len(fit.shapes)):
            own = problem.joint == np.flatnonzero(problem.arm.element_matrix[e])[-1]
            if own.any():
                # A coupled element carries the torque of the last joint that it acts on, in the rows of all its joints.
                load = np.full(problem.sample.max() + 1, float(np.mean(bare[own])))
                load[problem.sample[own]] = bare[own]
                column += coulomb[:, e] * load[problem.sample] / max(float(np.sqrt(np.mean(bare[own] ** 2))), _MIN_LOAD)
        with_load = self._augmented(column)
        value = float(with_load.value[-1])
        deviation = float(with_load.deviation[-1])
        if abs(value) <= _UPPER_SE * deviation:
            return np.zeros(len(unbounded_fit.value))
        size = f"{100.0 * value:.2g} % with a standard deviation of {100.0 * deviation:.2g} %"
        self.remarks.append(
            f"Coulomb friction changes with the load, at a joint's RMS torque by {size}: tau_c holds at the usual load "
            "of the runs, and its deviation contains the difference to no load"
        )
        return with_load.value[:-1] - unbounded_fit.value


def bounded_covariance(covariance: Array, sizes: Sequence[tuple[float, float]], largest: Sequence[float]) -> Array:
    """Return the covariance of all but the last parameters, where these lie between 0 and `largest`.

    The values hold for sizes of 0: the shift by a size is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between sizes are kept.

    Args:
        covariance: of q + k parameters.
        sizes: values and standard deviations of the last k.
        largest: upper bounds of these.
    """
    count = len(covariance) - len(sizes)
    between = covariance[count:, count:]
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    factor = np.array([
        np.sqrt(truncnorm(-value / deviation, (most - value) / deviation, value, deviation).moment(2)) / deviation
        for (value, deviation), most in zip(sizes, largest, strict=True)
    ])  # fmt: skip
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


_REDUCED_BANDWIDTH_SHARE = 0.5  # bandwidth over that of the positions
_AVERAGED_SAMPLES = 5


def blur_shifts(weighted: WeightedProblem, fit: SeparableFit, columns: Array) -> list[Array]:
    """Return the shifts of all parameters with a motion that is smoothed once more, arrays of shape (q,).

    There are none without rise and bristle: such friction depends only on the time of a reversal, which smoothing does
    not change.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around it, shape (r, q).
    """
    if not any({Part.STRIBECK, Part.BRISTLE} & shape.parts for shape in fit.shapes):
        return []
    problem = weighted.problem
    unfiltered = joint_columns(problem, fit.shapes)
    size = np.linalg.norm(columns * weighted.weight[:, None], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    tangent = columns * weighted.weight[:, None] / scale
    shifts = []
    blurs: list[Callable[[Array, FilteredRun], Array]] = [
        lambda values, run: run.smooth(values, _REDUCED_BANDWIDTH_SHARE * run.bandwidths.position),
        lambda values, _: np.asarray(uniform_filter1d(values, _AVERAGED_SAMPLES, axis=0)),
        _every_second,
    ]
    for blur in blurs:
        other = replace(problem, runs=tuple(_smoothed(run, blur) for run in problem.runs))
        difference = np.tensordot(unfiltered - joint_columns(other, fit.shapes), fit.linear, 2)
        shifts.append(np.asarray(np.linalg.lstsq(tangent, difference * weighted.weight, rcond=1e-8)[0] / scale))
    return shifts


def _smoothed(run: FilteredRun, blur: Callable[[Array, FilteredRun], Array]) -> FilteredRun:
    """Return a run with smoothed positions and velocities, and with velocities at the stamps smoothed alike."""
    blurred: dict[str, Any] = {
        name: blur(getattr(run, name), run) for name in ("position", "velocity", "torque_velocity")
    }
    return replace(run, **blurred)


def _every_second(values: Array, _: FilteredRun) -> Array:
    """Return values, shape (m, n), with every second one replaced by the mean of its neighbours."""
    result = values.copy()
    between = result[1:-1:2]
    between[:] = 0.5 * (result[:-2:2] + result[2::2])
    return result
