"""What the fit of the friction returns: models that were compared, elements with their laws, curves with bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.friction.law import FITTED, LINEAR, ElementShape, Part, steady_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.model.estimates import ElementEstimate

NORMAL_95 = 1.96


@dataclass(frozen=True)
class CrossValidation:
    """How well a model predicts what it was not fitted to.

    Attributes:
        error: weighted RMS of the residuals of what was left out, in noise deviations of the joints.
        deviation: standard error of `error`, from its scatter over the blocks.
        relative: RMS of these residuals over the RMS torque, all joints together.
        gain: by how much `error` is less than that of the model it is compared with; 0 for the first model.
        gain_deviation: standard error of `gain`, from paired differences over the blocks.
    """

    error: float
    deviation: float
    relative: float
    gain: float = 0.0
    gain_deviation: float = 0.0


@dataclass(frozen=True)
class ModelRow:
    """One row of the table of models.

    Attributes:
        name: of the model.
        against: name of the model that it is compared with; empty for the first.
        parts: of each element, in words, beside Coulomb and viscous friction.
        parameters: how many are fitted, rigid body and friction.
        error: weighted RMS of the residuals of the fit, in noise deviations of the joints.
        relative: of each joint, RMS residual over RMS torque, shape (n,).
        relative_all: the same, of all joints together.
        by_blocks: cross-validation by blocks of time.
        by_runs: cross-validation by runs; None where there is one run.
        kept: whether the model goes on into the next comparison.
        reason: why it is kept or not.
    """

    name: str
    against: str
    parts: tuple[tuple[str, ...], ...]
    parameters: int
    error: float
    relative: tuple[float, ...]
    relative_all: float
    by_blocks: CrossValidation
    by_runs: CrossValidation | None
    kept: bool
    reason: str


@dataclass(frozen=True)
class BlockDivision:
    """The blocks of time of the cross-validation.

    Attributes:
        length: of a block, s.
        count: of blocks.
        correlation_time: time in which the autocorrelation of the residuals fades, s.
        reason: how the length was chosen, in words.
    """

    length: float
    count: int
    correlation_time: float
    reason: str


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
