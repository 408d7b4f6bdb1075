"""The controller on textbook plants: six independent inertias behind unit gears."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joint_moves import HOME, LIMITS, PERIOD
from servo_rig import Rig
from unchecked import unchecked

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_emulator.loop.setup import Setup

FREE = 1e9  # a limit that is never met


@dataclasses.dataclass
class Servo:
    """A controller and six rotors of an inertia, which move exactly as bodies under constant torque."""

    controller: CS7B
    inertia: Array

    def __post_init__(self) -> None:
        self.position, self.velocity = np.zeros(6), np.zeros(6)
        self.controller.reset(self.position)

    def run(self, ticks: int, load: float = 0.0) -> tuple[Array, Array]:
        """Return positions (sampled before each command) and torques, each of shape (ticks, 6)."""
        period = self.controller.rates.period
        positions, torques = np.empty((ticks, 6)), np.empty((ticks, 6))
        for k in range(ticks):
            positions[k] = self.position
            torques[k] = self.controller.step(self.position, self.velocity)
            acceleration = (torques[k] + load) / self.inertia
            self.position = self.position + period * (self.velocity + 0.5 * period * acceleration)
            self.velocity = self.velocity + period * acceleration
        return positions, torques


@pytest.fixture(scope="session")
def servo(shipped: Setup) -> Callable[..., Servo]:
    def make(rates: Rates | None = None, inertia: float = 2.0, peak: float = FREE, **changed: Any) -> Servo:
        six = np.ones(6)
        drives = shipped.drives.replaced(
            transmission={"gear": six}, motor={"torque_constant": 0.5 * six, "peak_current": 2.0 * peak * six}
        )
        law = unchecked(
            shipped.controller,
            servo={
                "inertia": inertia * six,
                "kp": 40.0 * six,
                "kv": 300.0 * six,
                "ki": 1e5 * six,
                "integrator_limit": FREE * six,
            },
            feed_forward={"acceleration": False, "coulomb": False, "viscous": False},
            current_loop={"bandwidth": 800.0, "slew_rate": FREE * six},
            supervision={"following_error": FREE * six, "over_speed": FREE},
            trajectory={"start_tolerance": 10.0, "max_acceleration": FREE * six},
        )
        controller = CS7B(
            dataclasses.replace(shipped.robot, lower=-100 * six, upper=100 * six, max_velocity=1000 * six),
            drives,
            unchecked(law, **changed),
            rates or Rates(),
        )
        return Servo(controller, inertia * six)

    return make


@pytest.fixture
def generator() -> TrajectoryGenerator:
    return TrajectoryGenerator(LIMITS, PERIOD, HOME)


@pytest.fixture
def rig(shipped: Setup) -> Rig:
    controller = shipped.controller.replaced(supervision={"following_error": np.full(6, 0.3)})
    return Rig(dataclasses.replace(shipped, controller=controller))
