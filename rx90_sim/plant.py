"""The plant as the nodes and the closed loop use it: motor torques in, sampled states out."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, DivergenceError
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.friction import ELEMENT_COUNT, FrictionSet
from rx90_sim.joint_temperatures import JointTemperatures
from rx90_sim.plant_data import STATE_DTYPE, plant_record
from rx90_sim.plant_step import friction_states, plant_reset, plant_step

_NO_COMMAND = np.zeros(6)
_MOST_CORRECTIONS = 50


class Plant:
    """The arm with its drives and friction, advanced tick by tick.

    Attributes:
        joint_names: names of the six joints.
        friction_names: names of the seven friction elements.
        tick: number of the tick whose states are sampled now.
        constants: compiled constants, shape (1,), PLANT_DTYPE.
        state: compiled state, shape (1,), STATE_DTYPE.
        temperatures: how warm the joints are.
    """

    def __init__(
        self,
        robot: RobotModel,
        drives: DriveParameters,
        friction: FrictionSet,
        rates: Rates,
        substeps: int | None = None,
        seed: int = 0,
    ) -> None:
        self.joint_names = robot.joint_names
        self.friction_names = friction.names
        self.constants = plant_record(robot, drives, friction, rates, substeps, seed)
        self.state: np.ndarray[Any, Any] = (state := np.zeros(1, STATE_DTYPE))
        self.tick = 0
        self._lower, self._upper = robot.lower, robot.upper
        sensed = self.constants["sensor"]["used"][0]
        torque = state["sensor"]["torque"][0] if sensed else state["motor_torque"][0]
        self._motor_states = state["motor_position"][0], state["motor_velocity"][0], torque
        self._joint_states = state["q"][0], state["v"][0], state["drive_torque"][0]
        self._friction_states = state["z"][0], np.zeros(ELEMENT_COUNT), np.zeros(ELEMENT_COUNT)
        self.temperatures = JointTemperatures(friction, self.constants, state)
        self.reset(np.clip(np.zeros(6), self._lower, self._upper))

    def reset(self, position: ArrayLike) -> None:
        """Put the arm at rest at `position`, rad, shape (6,), brakes closed, tick 0.

        It is the position by the encoders; where gears are elastic, the links hang a little off it.

        Raises:
            ConfigError: if the position is not six finite numbers within the joint limits.
        """
        target = np.array(position, dtype=np.float64)
        if target.shape != (6,):
            raise ConfigError(f"initial position has shape {target.shape}; accepted: (6,)")
        for name, value, low, high in zip(self.joint_names, target, self._lower, self._upper, strict=True):
            if not low <= value <= high:
                raise ConfigError(f"initial position of {name} is {value} rad; accepted: [{low:.4f}, {high:.4f}]")
        plant_reset(self.constants, self.state, target)
        self.tick = 0

    def position_of(self, links: ArrayLike) -> Array:
        """Return the position for `reset`, rad, shape (6,), that leaves the links at rest where they are wanted.

        To the last bit wherever rounding allows, so that a run that is done again from its first sample has the same
        bits.
        """
        wanted = np.array(links, dtype=np.float64)
        position = wanted.copy()
        for _ in range(_MOST_CORRECTIONS):
            self.reset(position)
            off = wanted - self.state["q"][0]
            if not off.any():
                break
            position += off
        return position

    def warm_up(self) -> None:
        """Compile, or load, every kernel that a run calls, and come back to the state before."""
        before, tick = self.state.copy(), self.tick
        self.reset(before["q"][0])
        self.step(_NO_COMMAND)
        self.step(None)
        self.friction_states()
        self.state[:], self.tick = before, tick

    def step(self, command: Array | None) -> None:
        """Hold motor torques for one tick; None takes the torque away and closes the brakes.

        Args:
            command: motor torques, motor side, Nm, shape (6,).

        Raises:
            DivergenceError: naming joint and tick; the state is then no longer of use.
        """
        if command is None:
            joint = plant_step(self.constants, self.state, _NO_COMMAND, False)
        else:
            joint = plant_step(self.constants, self.state, command, True)
        self.tick += 1
        if joint >= 0:
            self.raise_divergence(joint)

    def raise_divergence(self, joint: int) -> NoReturn:
        """Raise the error that names joint and tick."""
        raise DivergenceError(
            f"the state of {self.joint_names[joint]} diverged in tick {self.tick}: velocity "
            f"{self.state['v'][0, joint]:g} rad/s; accepted: finite and up to "
            f"{self.constants['speed_limit'][0, joint]:g} rad/s"
        )

    @property
    def substeps(self) -> int:
        """Return how many steps the plant takes in a tick."""
        return int(self.constants["substeps"][0])

    @property
    def brakes_closed(self) -> bool:
        """Return whether the brakes hold the arm."""
        return bool(self.state["brakes_closed"][0])

    @property
    def saturated(self) -> NDArray[np.int64]:
        """Return for how many ticks each motor gave less than its command, shape (6,)."""
        return np.array(self.state["saturated"][0])

    def winding_temperatures(self) -> Array:
        """Return how warm the windings of the motors are, degrees Celsius, shape (6,)."""
        return np.array(self.state["temperature"][0])

    def motor_states(self) -> tuple[Array, Array, Array]:
        """Return position by the encoder rad, observed velocity rad/s, torque by the current sensor Nm, motor side.

        Views of the state, always the same ones.
        """
        return self._motor_states

    def joint_states(self) -> tuple[Array, Array, Array]:
        """Return joint position rad, velocity rad/s and drive torque at the joint Nm, shape (6,); views, as above."""
        return self._joint_states

    def friction_states(self) -> tuple[Array, Array, Array]:
        """Return bristle deflection rad, input velocity rad/s and friction torque Nm, shape (7,).

        Always the same arrays, brought up to date by this call.
        """
        _, velocity, torque = self._friction_states
        friction_states(self.constants, self.state, velocity, torque)
        return self._friction_states
