"""Ramps of an emulated rig without its firmware and its line: the same plant and the same staircase, compiled.

A ramp costs milliseconds instead of seconds, so that hundreds of measurements can be made. The firmware's ramp in
rig.c is written again here in three lines; a test holds readings against those of the rig with the real firmware.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_bench.experiment.record import RampRecord
from friction_bench.experiment.session import near_limits
from friction_bench.rig.plant import SLICE, RigJoint, Shaft, joint_record, shaft_of, turn, turn_with_joint
from friction_bench.rig.rig_file import CODES, RAMP_FRACTION, PlantParameters, Rig
from rx90_common.friction.element import FrictionElement
from rx90_common.kernels.compiled import kernel

SLICES = 20
"""Slices of 1 ms in a tick."""
Array = NDArray[np.float64]


@kernel
def _ramp(
    torque: Array,
    noise: Array,
    electrics: tuple[float, float, float],
    shaft: Shaft,
    gear: tuple[float, float, float],
    joint: RigJoint,
    with_bristle: bool,
) -> tuple[Array, Array]:
    """Return angle at the beginning of each tick and motor torque of the slice before, each shape (n,)."""
    constant, resistance, supply = electrics
    angle = speed = bristle = motor = 0.0
    angles, motors = np.empty(torque.size), np.empty(torque.size)
    for k in range(torque.size):
        angles[k], motors[k] = angle, motor
        for i in range(SLICES):
            highest = (supply - constant * speed) / resistance * constant
            wanted = torque[k] + noise[k, i] if torque[k] > 0.0 else 0.0
            motor = max(0.0, min(wanted, highest))
            if with_bristle:
                angle, speed, bristle = turn_with_joint((angle, speed, bristle), motor, shaft, gear, joint, 1e-3)
            else:
                angle, speed = turn(angle, speed, motor, shaft, 1e-3)
    return angles, motors


@dataclass
class QuickRig:
    """A rig that runs ramps; amplifier and noise are drawn from `seed`, once and for each ramp."""

    rig: Rig
    seed: int

    def __post_init__(self) -> None:
        assert self.rig.plant is not None
        self.plant: PlantParameters = self.rig.plant
        self._rng = np.random.default_rng(self.seed)
        self.gain = 1.0 + self.plant.gain_error * self._rng.standard_normal()

    def ramp(self, slope: float, end_torque: float, loaded: bool, label: str) -> RampRecord:
        """Return one ramp; it ends, as that of the host, where the rig file's speed or travel is nearly reached."""
        rig, plant = self.rig, self.plant
        step = rig.ramp_step(slope)
        ticks = np.arange((rig.end_code(end_torque) * RAMP_FRACTION - 128 + step - 1) // step)
        command = rig.torque(1) * ((128 + ticks * step) // RAMP_FRACTION)
        noise = plant.torque_noise * self._rng.standard_normal((ticks.size, SLICES))
        joint = plant.joint
        element = joint if isinstance(joint, FrictionElement) else FrictionElement(1, 1, 1, 1, 1, 1, 1, 0, 0)
        angle, motor = _ramp(
            self.gain * command,
            noise,
            (plant.torque_constant, plant.resistance, plant.supply),
            shaft_of(rig, loaded),
            (rig.gear_ratio, rig.gear_efficiency, plant.load_inertia + plant.joint_inertia),
            joint_record(element, rig.gear_ratio, SLICE, self.seed),
            loaded and isinstance(joint, FrictionElement),
        )
        scale = rig.counts_per_revolution / math.tau
        counts = np.floor(angle * scale + self._rng.random())
        beyond = near_limits(rig, counts)
        end = int(np.argmax(beyond)) if beyond.any() else ticks.size
        reading = np.maximum(0.0, motor + plant.adc_noise * self._rng.standard_normal(ticks.size))
        codes = np.minimum(CODES, np.rint(reading / rig.adc_full_scale * CODES))
        return RampRecord(
            time=ticks[:end] * rig.tick,
            angle=(counts[:end] - counts[0]) / scale,
            slope=rig.slope_of_step(step),
            angle_step=1 / scale,
            torque=command[:end],
            measured_torque=codes[:end] * rig.adc_full_scale / CODES,
            loaded=loaded,
            label=label,
        )
