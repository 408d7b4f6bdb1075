"""The covariance of a group's fit: noise, cluster-robust widening, and the sliding regime's own uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.model.estimates import SLIDING
from rx90_emulator.identification.presliding.residual import INERTIA_DEVIATION, Clusters, GroupResidual

_DIFFERENCE = 1e-4  # relative step of difference quotients
_FEW = 3  # motions, below which they are too few to be clusters
_LEAST_REST = 1e-3  # lower bound of 1 - leverage: a motion's own start deflection has none
_LEAST_INFORMATION = 0.1  # of the prior deviation of the inertia, that the data must take off it
_FLOOR = (0.002, 0.01)  # relative, of c0 and c1: encoder steps, and 10 us of timing, show in no residual


def group_covariance(residual: GroupResidual, x: Array, sliding_covariance: Array | None) -> tuple[Array, Array]:
    """Return the covariance of the parameters at the solution, and the scores of the inertia's errors.

    Args:
        residual: of the fit.
        x: solution, shape (p,).
        sliding_covariance: of the sliding regime, element by element in the order of SLIDING, shape (7 e, 7 e); None
            if it is known.

    Returns:
        Covariance, shape (p, p), and what `_inertia_scores` returns, shape (k, n).
    """
    values, jacobian = residual(x), residual.jacobian(x)
    clusters = residual.clusters()[: 1 if len(residual.motions) < _FEW else 2]
    covariance = _cluster_robust(jacobian, values, clusters)
    if sliding_covariance is not None:
        slopes = np.linalg.lstsq(jacobian, -_by_sliding(residual, x, values), rcond=None)[0]
        covariance = covariance + slopes @ sliding_covariance @ slopes.T
    parameters = residual.parameters
    floor = np.append(np.tile(_FLOOR, parameters.elements), np.zeros(x.size - parameters.bristles))
    covariance = covariance + np.diag(floor) ** 2
    return covariance, _inertia_scores(residual, x, jacobian, covariance)


def _cluster_robust(jacobian: Array, residual: Array, groupings: Sequence[Clusters]) -> Array:
    """Return the covariance by the noise, widened where clusters of residuals show more than noise would.

    The noise is white in the band, and it is what lies between the spectral lines of the motions. Errors of the model
    lie on the lines and grow with the amplitude; cluster-robust (sandwich) estimates show them. These are the
    bias-reduced linearisation of Bell and McCaffrey (CR2; Survey Methodology 28, 2002), which is unbiased where there
    is only noise, also with few clusters of unequal leverage.

    Args:
        jacobian: shape (q, p).
        residual: shape (q,).
        groupings: number of the cluster of each residual, each shape (q,); the one that shows most counts.
    """
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    inverse_root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])) @ vectors.T
    noise = inverse_root @ inverse_root
    wide = np.ones(len(noise))
    for numbers in groupings:
        variance = np.zeros(len(noise))
        for number in range(int(numbers.max()) + 1):
            rows = numbers == number
            own = jacobian[rows] @ inverse_root
            leverage, turn = np.linalg.eigh(own.T @ own)
            adjusted = turn / np.sqrt(np.maximum(1.0 - leverage, _LEAST_REST)) @ turn.T
            variance += (inverse_root @ (adjusted @ (own.T @ residual[rows]))) ** 2
        wide = np.maximum(wide, np.sqrt(variance / np.diag(noise)))
    return np.asarray(noise * np.outer(wide, wide))


def _by_sliding(residual: GroupResidual, x: Array, here: Array) -> Array:
    """Return the derivatives of the residuals by the sliding parameters, element by element, shape (q, 7 e).

    A bristle's start, in parts of its deflection in steady sliding, is left where it is.
    """
    columns = []
    for n, element in enumerate(residual.friction.sliding):
        for name in SLIDING:
            # The Coulomb torque goes down, which keeps it below the static one.
            step = getattr(element, name) * (-_DIFFERENCE if name.startswith("tau_c") else _DIFFERENCE)
            moved = replace(element, **{name: getattr(element, name) + step})
            changed = replace(residual, friction=residual.friction.with_element(n, moved))
            columns.append((changed(x) - here) / step if step else np.zeros_like(here))
    return np.column_stack(columns)


def _inertia_scores(residual: GroupResidual, x: Array, jacobian: Array, covariance: Array) -> Array:
    """Return the errors of the mass matrix over the deviations that they would have if the prior held, shape (k, n).

    The prior shrinks the errors towards zero: where it holds, their variance is the prior's less the posterior's. What
    the covariance has beyond noise may be errors of the model instead of the inertia, and is added.
    """
    own = slice(residual.parameters.bristles, residual.parameters.shared)
    posterior = np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))[own]
    beyond = np.maximum(np.diag(covariance)[own] - posterior, 0.0)
    least = (_LEAST_INFORMATION * INERTIA_DEVIATION) ** 2
    scores = np.zeros_like(x)
    scores[own] = x[own] / np.sqrt(np.maximum(INERTIA_DEVIATION**2 - posterior, least) + beyond)
    return residual.parameters.inertia_errors(scores)
