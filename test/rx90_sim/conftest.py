"""Oracles and small plants for the tests of what nature does."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from elastic_arms import WRIST
from lugre_oracle import LuGreOracle
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from benchmarks.hybrid_reference import decoupled_setup, negligible_element
from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant


@dataclass(frozen=True)
class ArmOracle:
    setup: Setup
    turns: Array = dataclasses.field(default_factory=lambda: WRIST)

    @cached_property
    def inputs(self) -> Array:
        together = [row for row in self.turns if np.count_nonzero(row) > 1]
        return np.vstack([np.eye(len(self.turns)), *together])

    @cached_property
    def _data(self) -> Any:
        return self.setup.robot.model.createData()

    def mass_and_bias(self, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Return M with rotors and coupling, and h with the spring."""
        model, drives, position = self.setup.robot.model, self.setup.drives, np.asarray(q, float)
        upper = np.triu(pin.crba(model, self._data, position))
        bias = pin.nonLinearEffects(model, self._data, position, np.asarray(v, float))
        rotors = self.turns.T @ np.diag(drives.rotor_inertia) @ self.turns
        return upper + np.triu(upper, 1).T + rotors, bias + drives.spring_torque * np.sin(position)

    def integrate(self, state: Array, motor: ArrayLike, duration: float, tolerance: float) -> Array:
        """Return (q, v, z), shape (2 n + e,), after `duration` seconds of constant motor torques."""
        lugre = LuGreOracle(self.setup.friction.elements)
        drive, n = self.turns.T @ (self.setup.drives.gear * np.asarray(motor, float)), len(self.turns)

        def rhs(_: float, y: Array) -> Array:
            q, v, z = y[:n], y[n : 2 * n], y[2 * n :]
            z_dot, friction = lugre.rates(z, self.inputs @ v)
            mass, bias = self.mass_and_bias(q, v)
            return np.concatenate([v, np.linalg.solve(mass, drive - bias - self.inputs.T @ friction), z_dot])

        result = solve_ivp(rhs, (0.0, duration), state, "Radau", rtol=tolerance, atol=tolerance * 1e-2)
        assert result.success
        return np.asarray(result.y[:, -1])


@pytest.fixture(scope="session")
def arm_oracle(shipped: Setup) -> ArmOracle:
    return ArmOracle(shipped)


@pytest.fixture(scope="session")
def frictionless() -> FrictionSet:
    names = tuple(f"element_{i}" for i in range(7))
    return FrictionSet(names, (negligible_element(),) * 7)


@pytest.fixture(scope="session")
def masses(shipped: Setup) -> Callable[..., Plant]:
    def make(elements: Sequence[FrictionElement], inertia: float = 1.0, base_hz: int = 4000) -> Plant:
        setup = dataclasses.replace(decoupled_setup(shipped, elements, inertia), rates=Rates(base_hz, base_hz // 4))
        return setup.plant()

    return make
