"""The selected friction: elements as they were fitted, their curves, and the parameters of FrictionElement.

From the selected model to the parameters of FrictionElement, with deviations, or the reason why one is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.friction.cross_validation import BlockDivision
from rx90_emulator.identification.excitation.friction.law import (
    FITTED,
    LINEAR,
    VISCOUS,
    ElementShape,
    Part,
    steady_columns,
)
from rx90_emulator.identification.excitation.friction.selection import ModelRow
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.records import BagSource

NORMAL_95 = 1.96


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Steady friction torque of an element against its velocity, over velocities at which there were data.

    Attributes:
        element: its name.
        velocity: rad/s, shape (k,), increasing, both signs.
        torque: Nm, shape (k,).
        deviation: standard deviation of the torque, Nm, shape (k,).
    """

    element: str
    velocity: Array
    torque: Array
    deviation: Array

    @property
    def band(self) -> tuple[Array, Array]:
        """Return lower and upper bound of the torque at 95 %, Nm, each shape (k,)."""
        return self.torque - NORMAL_95 * self.deviation, self.torque + NORMAL_95 * self.deviation


@dataclass(frozen=True, eq=False)
class FittedElement:
    """The friction of one element as it was fitted.

    Attributes:
        element: its name.
        shape: the parameters that are not linear, and the parts it has.
        linear: tau_c, c2 and c1, in Nm, Nm (s/rad)^alpha, Nm s/rad; 0 for what it does not have, shape (3,).
        covariance: of the parameters in FITTED, shape (8, 8); 0 for what is not fitted. The exponent of a viscous
            part is free in it where the runs were asked for exponents, also if it is left at 1: what is not known of
            it is not known of tau_c and c2 either.
        ranges: least and greatest speed of its data in each direction, positive and negative: ((low, high),
            (low, high)), rad/s; (0, 0) for a direction in which it did not move.
    """

    element: str
    shape: ElementShape
    linear: Array
    covariance: Array
    ranges: tuple[tuple[float, float], tuple[float, float]]

    def curve(self, velocity: Array | None = None, points: int = 60) -> FrictionCurve:
        """Return the steady friction torque with its deviation.

        Args:
            velocity: rad/s, shape (k,); by default over all velocities at which there were data.
            points: of each direction, by default.

        Raises:
            IdentificationError: for a velocity at which there were no data.
        """
        given = self._velocities(points) if velocity is None else np.asarray(velocity, dtype=np.float64)
        (low, high), (low_back, high_back) = self.ranges
        inside = ((given >= low) & (given <= high)) | ((-given >= low_back) & (-given <= high_back))
        if not inside.all():
            found = f"{self.element}: velocity {given[~inside][0]:.4g} rad/s"
            accepted = f"{-high_back:.4g} to {-low_back:.4g} and {low:.4g} to {high:.4g} rad/s, where there were data"
            raise IdentificationError(f"{found}; accepted: {accepted}")
        columns, derivatives = steady_columns(self.shape, given)
        slopes = [derivatives[name] @ self.linear for name in FITTED[len(LINEAR) :]]
        matrix = np.column_stack([columns, *slopes])
        variance = np.einsum("ki,ij,kj->k", matrix, self.covariance, matrix)
        return FrictionCurve(self.element, given, columns @ self.linear, np.sqrt(np.maximum(variance, 0.0)))

    def _velocities(self, points: int) -> Array:
        (low, high), (low_back, high_back) = self.ranges
        forward = np.geomspace(low, high, points) if high > 0.0 else np.empty(0)
        backward = -np.geomspace(low_back, high_back, points)[::-1] if high_back > 0.0 else np.empty(0)
        return np.concatenate([backward, forward])


@dataclass(frozen=True, eq=False)
class FrictionSelection:
    """The friction of all elements with the parts that predict better, and the models that were compared.

    Attributes:
        models: rows of the table, in the order in which they were compared.
        blocks: of the cross-validation.
        fitted: elements as they were fitted, in the arm's order.
        elements: their estimates by the names of FrictionElement, with the reason for each that is not identifiable.
        fit: of the kept model, linear around the non-linear parameters (whose values there are their last changes):
            the problem's parameters, then the friction's, with HAC covariance. Its last values may be exponents that
            are left at 1, and whose uncertainty the covariance knows.
        names: of the values of `fit`; a friction parameter is `element.parameter`.
        predicted: torque of every row by the kept model, Nm, shape (r,).
        remarks: what a reader of the figures must know.
    """

    models: tuple[ModelRow, ...]
    blocks: BlockDivision
    fitted: tuple[FittedElement, ...]
    elements: tuple[ElementEstimate, ...]
    fit: LinearFit
    names: tuple[str, ...]
    predicted: Array
    remarks: tuple[str, ...]

    @property
    def parts(self) -> tuple[frozenset[Part], ...]:
        """Return the parts that each element has."""
        return tuple(one.shape.parts for one in self.fitted)

    def curves(self) -> tuple[FrictionCurve, ...]:
        """Return the curves of all elements, over the velocities at which there were data."""
        return tuple(one.curve() for one in self.fitted)


_MAX_ALPHA_SD = 0.3  # deviation of an exponent that says nothing about it
_MAX_RELATIVE_SD = {"omega_s": 0.5, "delta": 0.5, "c0": 0.5, "c1": 0.25}
"""Relative deviation up to which one of these counts as known.

Damping is kept where it happens to come out large: of values that stand out by less than four deviations, most are too
large.
"""

Refusal = Callable[[Part], str]


def element_estimate(one: FittedElement, refusal: Refusal, sources: tuple[BagSource, ...]) -> ElementEstimate:
    """Return the estimates of an element by the names of FrictionElement.

    Args:
        one: the element as it was fitted.
        refusal: why it does not have a part.
        sources: the runs.
    """
    slopes = _natural(one)
    names = tuple(slopes)
    jacobian = np.array([slope for _, slope in slopes.values()])
    known = np.isfinite(np.diag(one.covariance))
    finite = np.where(np.outer(known, known), one.covariance, 0.0)
    covariance = jacobian @ finite @ jacobian.T
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    deviations[(jacobian[:, ~known] != 0.0).any(axis=1)] = math.inf
    estimates = {}
    for name, deviation in zip(names, deviations.tolist(), strict=True):
        value = slopes[name][0]
        reason = _reason(one, name, value, deviation, refusal)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else ParameterEstimate(value, deviation)
    return ElementEstimate.of(one.element, estimates, covariance, sources)


def _natural(one: FittedElement) -> dict[str, tuple[float, Array]]:
    """Return values by name with their derivatives by the parameters of the fit, shape (8,)."""
    shape = one.shape
    tau_c, c2, c1 = one.linear.tolist()

    def by(**slopes: float) -> Array:
        return np.array([slopes.get(name, 0.0) for name in FITTED])

    coulomb = (tau_c, by(tau_c=1.0))
    static, omega_s, c0 = coulomb, (math.nan, by()), (math.nan, by())
    if Part.STRIBECK in shape.parts:
        static = (tau_c * (1.0 + shape.rise), by(tau_c=1.0 + shape.rise, rise=tau_c))
        omega_s = (shape.omega_s, by(omega_s=shape.omega_s))
    if Part.BRISTLE in shape.parts:
        c0 = (tau_c * shape.stiffness, by(tau_c=shape.stiffness, stiffness=tau_c * shape.stiffness))
    return {
        "tau_c_positive": coulomb, "tau_c_negative": coulomb, "tau_s_positive": static, "tau_s_negative": static,
        "omega_s": omega_s, "delta": (shape.delta, by(delta=1.0)), "c2": (c2, by(c2=1.0)),
        "alpha": (shape.alpha, by(alpha=1.0)), "c0": c0, "c1": (c1, by(c1=1.0)),
    }  # fmt: skip


_PART_OF = {
    "tau_s_positive": Part.STRIBECK, "tau_s_negative": Part.STRIBECK, "omega_s": Part.STRIBECK, "delta": Part.STRIBECK,
    "c0": Part.BRISTLE, "c1": Part.DAMPING,
}  # fmt: skip


def _reason(one: FittedElement, name: str, value: float, deviation: float, refusal: Refusal) -> str:
    """Return why a parameter is not known; empty if it is."""
    part = _PART_OF.get(name)
    if part is not None and part not in one.shape.parts:
        return refusal(part)
    if name == "delta" and "delta" in one.shape.fixed:
        return "not told from the size of the rise; 1 was assumed"
    weak = deviation > (
        _MAX_ALPHA_SD if name == "alpha" else _MAX_RELATIVE_SD[name] * value if name in _MAX_RELATIVE_SD else math.inf
    )
    checks = (
        (not one.linear.any(), "the element does not move, or at one velocity alone"),
        (name.startswith("tau") and value <= 0.0, "no Coulomb friction shows: the best value is 0"),
        (name in ("c2", "alpha") and one.linear[VISCOUS] <= 0.0, "no viscous friction shows: the best value is 0"),
        (not math.isfinite(value) or not math.isfinite(deviation), "the runs do not determine it"),
        (weak, f"standard deviation {deviation:.3g} at a value of {value:.3g}"),
    )
    return next((reason for applies, reason in checks if applies), "")
