"""What is true of a random arm for a model that leaves something out: the parameters that fit best, on many motions.

Friction that grows with the load has no one Coulomb torque. What an identification from some runs can find, and what
its intervals must hold, are the parameters that a least-squares fit has in the limit of ever more runs of the same
kind: pseudo-true values (White 1982). They are computed here from exact motions and torques, with SciPy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.excitation_runs import Disturbances, FourierMotion, torque_along
from benchmarks.random_arms import SyntheticArm

Array = NDArray[np.float64]
Columns = Callable[[Array, Array, Array], Array]
"""Columns of base parameters for positions, velocities and accelerations: (m, n) each to (m, n, b)."""

_SAMPLES = 60
_EXPONENT, _STRIBECK = (0.1, 2.0), (1e-3, 2.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """Pseudo-true values.

    Attributes:
        base: of the base parameters, shape (b,).
        coulomb: mean of both directions, Nm, shape (n_el,), as are the following.
        viscous: torque at 1 rad/s, Nm.
        exponent: of the velocity.
        rise: static over Coulomb torque, less 1; 0 for elements without.
        omega_s: Stribeck velocity for the exponent delta = 1, rad/s; NaN for elements without.
    """

    base: Array
    coulomb: Array
    viscous: Array
    exponent: Array
    rise: Array
    omega_s: Array


def truth_of(
    arm: SyntheticArm,
    columns: Columns,
    sigma: Array,
    disturbances: Disturbances,
    motion: Callable[[int], FourierMotion],
    motions: int = 40,
) -> Truth:
    """Fit exact torques of many motions, each joint in units of `sigma`, its residuals' deviation, Nm, shape (n,).

    Args:
        arm: bristles are left out: in steady sliding they change nothing.
        columns: of the base parameters.
        sigma: weights of the joints.
        disturbances: of which the load dependence of friction is taken.
        motion: makes a random motion from a seed.
        motions: how many.
    """
    steady = replace(arm, friction=tuple(replace(law, c0=0.0, c1=0.0) for law in arm.friction))
    rng = np.random.default_rng(7)
    parts = []
    for seed in range(motions):
        one = motion(900_000 + seed)
        time = np.sort(rng.uniform(one.rest, one.duration - one.rest, _SAMPLES))
        exact = one.at(time)
        parts.append(
            (columns(*exact), exact[1] @ arm.element_matrix.T, torque_along(steady, time, exact, disturbances.load))
        )
    linear, inputs, torque = (np.concatenate(values) for values in zip(*parts, strict=True))
    weight = 1.0 / np.asarray(sigma)
    stribeck = [k for k, law in enumerate(arm.friction) if law.rise > 0.0]
    basis, upper = np.linalg.qr((linear * weight[:, None]).reshape(-1, linear.shape[2]))
    target = (torque * weight).ravel()

    def friction(shape: Array) -> Array:
        size, sign = np.abs(inputs), np.sign(inputs)
        powers = sign * size ** shape[: inputs.shape[1]]
        decays = sign[:, stribeck] * np.exp(-size[:, stribeck] / np.exp(shape[inputs.shape[1] :]))
        acting = np.concatenate([sign, powers, decays], axis=1)
        matrix = np.concatenate([arm.element_matrix, arm.element_matrix, arm.element_matrix[stribeck]])
        return np.einsum("mk,kj->mjk", acting, matrix * weight).reshape(-1, len(matrix))

    def fitted(shape: Array) -> tuple[Array, Array]:
        own = friction(shape)
        free = own - basis @ (basis.T @ own)
        values = np.linalg.lstsq(free, target - basis @ (basis.T @ target), rcond=None)[0]
        rest = target - own @ values
        return values, rest - basis @ (basis.T @ rest)

    start = [law.alpha for law in arm.friction] + [np.log(arm.friction[k].omega_s) for k in stribeck]
    low, high = np.log(_STRIBECK)
    bounds = (
        [_EXPONENT[0]] * len(arm.friction) + [low] * len(stribeck),
        [_EXPONENT[1]] * len(arm.friction) + [high] * len(stribeck),
    )
    shape = least_squares(lambda x: fitted(x)[1], start, bounds=bounds, x_scale=0.1).x
    values, _ = fitted(shape)
    base = np.linalg.solve(upper, basis.T @ (target - friction(shape) @ values))
    n = len(arm.friction)
    rise, omega = np.zeros(n), np.full(n, np.nan)
    rise[stribeck] = values[2 * n :] / values[stribeck]
    omega[stribeck] = np.exp(shape[n:])
    return Truth(base, values[:n], values[n : 2 * n], shape[:n], rise, omega)
