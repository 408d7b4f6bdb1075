"""Friction of a robot joint over speed, load and temperature as published, and as an element of this project has it.

    python -m benchmarks.published_friction [--plot docs/images/published_friction.png]

Bittencourt and Gunnarsson (2012), Static Friction in a Robot Joint - Modeling and Identification of Load and
Temperature Effects, J. Dyn. Sys. Meas. Control 134(5) 051013: load and temperature change a joint's Stribeck curve.
Torques are shares of the joint's largest torque, speeds the motor's. Their numbers are those that Yan, Li and Meng
(2020), Proc. IMechE J, doi 10.1177/1350650120954943, carry on (github.com/qiyan98/Manipulator-dynamics, FunFriction.m).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy.optimize import minimize_scalar

from benchmarks.report import PLOT, WIDTH, arguments, plain_decades, publish
from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.step import (
    fill_parts,
    parts_dtype,
    parts_state_dtype,
    parts_step,
    reset_parts,
)
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store
from rx90_common.report.picture import picture
from rx90_common.report.style import COLOURS

COULOMB, COULOMB_LOAD = 3.11e-2, 2.34e-2
STATIC_LOAD, SPEED_LOAD = 1.26e-1, 9.22  # of the load: Stribeck torque, and its speed in rad/s
# without load: Stribeck torque at 0 degrees Celsius, and by degree
STATIC, STATIC_TEMPERATURE = (-2.50e-2, 1.60e-3)
SPEED, SPEED_TEMPERATURE = -24.81, 0.98  # its speed, rad/s, the same
EXPONENT = 1.36
# s/rad, s/rad, degrees Celsius
VISCOUS, VISCOUS_TEMPERATURE, TEMPERATURE_SCALE = (1.30e-4, 1.32e-3, 20.71)

LOADS = (0.0, 0.2, 0.4, 0.6, 0.8)
TEMPERATURES = (30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
REFERENCE = 40.0
"""Degrees Celsius, at which the element of this project has its own parameters."""
SPEEDS = np.geomspace(0.1, 280.0, 400)
_LONG = 1e6
"""s; a bristle's step is exact however long it is."""


def published(speed: Array, torque: float, temperature: float) -> Array:
    """Return the friction of the paper's model for speeds above 0, rad/s."""
    of_load = STATIC_LOAD * torque * np.exp(-((speed / SPEED_LOAD) ** EXPONENT))
    stribeck = _stribeck(temperature) * np.exp(
        -((speed / _stribeck_speed(temperature)) ** EXPONENT)
    )
    return np.asarray(
        COULOMB + COULOMB_LOAD * torque + of_load + stribeck + _viscous(temperature) * speed
    )


def element_at(temperature: float) -> FrictionElement:
    """Return an element with the paper's load and temperature, which starts with this one."""
    static, viscous, speed = _stribeck(REFERENCE), _viscous(REFERENCE), _stribeck_speed(REFERENCE)
    by_load = LoadPart(
        driving=COULOMB_LOAD,
        driven=COULOMB_LOAD,
        stribeck_driving=STATIC_LOAD,
        stribeck_driven=STATIC_LOAD,
        omega_s=SPEED_LOAD,
    )
    by_temperature = TemperaturePart(
        reference=REFERENCE, lowest=TEMPERATURES[0], highest=TEMPERATURES[-1], start=temperature,
        ambient=TEMPERATURES[0], capacity=1e9, resistance=1.0, viscous_scale=TEMPERATURE_SCALE,
        viscous_floor=VISCOUS / viscous, speed_slope=SPEED_TEMPERATURE / speed,
        static_slope=STATIC_TEMPERATURE / static,
    )  # fmt: skip
    peak = COULOMB + static
    return FrictionElement(
        tau_c=COULOMB,
        tau_s=peak,
        omega_s=speed,
        delta=EXPONENT,
        c0=1e3,
        c1=0.0,
        c2=viscous,
        load=by_load,
        temperature=by_temperature,
    )


def _stribeck(temperature: float) -> float:
    return STATIC + STATIC_TEMPERATURE * temperature


def _stribeck_speed(temperature: float) -> float:
    return SPEED + SPEED_TEMPERATURE * temperature


def _viscous(temperature: float) -> float:
    return VISCOUS + VISCOUS_TEMPERATURE * float(np.exp(-temperature / TEMPERATURE_SCALE))


def of_element(torque: float, temperature: float) -> Array:
    """Return the friction of that element in steady motion at SPEEDS under a load, as the plant's kernel has it."""
    elements = [element_at(temperature)] * RX_WRIST.size.elements
    parts, states = (
        np.zeros(1, parts_dtype(RX_WRIST.size.elements)),
        np.zeros(1, parts_state_dtype(RX_WRIST.size.elements)),
    )
    fill_parts(parts[0], elements, np.ones(RX_WRIST.size.elements).tolist(), 1.0, 0)
    friction = np.empty((len(SPEEDS), RX_WRIST.size.elements))
    _steady(
        element_arrays(elements),
        parts,
        states,
        np.full(RX_WRIST.size.elements, torque),
        SPEEDS,
        friction,
    )
    return friction[:, 0]


@kernel
def _steady(
    elements: Any, parts: Any, states: Any, transmitted: Array, speeds: Array, torque: Array
) -> None:
    """Write the torque of seven elements at each speed after a long time, shape (n, 7)."""
    reset_parts(parts[0], states[0], load(transmitted, 7), 7)
    still = 0.0 * load(transmitted, 7)
    for k in range(len(speeds)):
        z, _ = parts_step(
            elements[0], parts[0], states[0], still, still, still + speeds[k], _LONG, 7
        )
        _, mean = parts_step(
            elements[0], parts[0], states[0], z, still, still + speeds[k], _LONG, 7
        )
        store(torque[k], mean)


def trends() -> dict[str, float]:
    """Return what load and temperature do, and how far the element is from the paper, as figures."""
    slow, fast = np.array([1.0]), np.array([200.0])

    def ratio(speed: Array, first: tuple[float, float], second: tuple[float, float]) -> float:
        """Return friction at the second load and temperature over that at the first."""
        return float((published(speed, *second) / published(speed, *first))[0])

    def slowest(temperature: float) -> float:
        """Return the speed of least friction without load."""
        found = minimize_scalar(
            lambda speed: float(published(np.array([speed]), 0.0, temperature)[0]),
            bounds=(1.0, 280.0),
            method="bounded",
        )
        return float(found.x)

    return {
        "published_friction_load_slow": ratio(slow, (0.0, 40.0), (0.8, 40.0)),
        "published_friction_load_fast": ratio(fast, (0.0, 40.0), (0.8, 40.0)),
        "published_friction_hot_slow": ratio(slow, (0.0, 30.0), (0.0, 80.0)),
        "published_friction_hot_fast": ratio(fast, (0.0, 30.0), (0.0, 80.0)),
        "published_friction_minimum_cold": slowest(30.0),
        "published_friction_minimum_hot": slowest(80.0),
        "published_friction_error_temperature": max(error(0.0, t) for t in TEMPERATURES),
        "published_friction_error_load": max(error(each, REFERENCE) for each in LOADS),
        "published_friction_error_both": max(
            error(each, t) for each in LOADS for t in TEMPERATURES
        ),
    }


def error(torque: float, temperature: float) -> float:
    """Return the largest deviation of the element from the paper over all speeds, as a share of the paper's value."""
    return float(
        np.max(
            np.abs(of_element(torque, temperature) / published(SPEEDS, torque, temperature) - 1.0)
        )
    )


def draw(file: Path) -> None:
    """Draw curves over speed, for loads at 40 degrees and for temperatures without load; published ones are solid."""
    with picture(file) as figure:
        figure.set_size_inches(WIDTH, 3.6)
        over_load, over_temperature = figure.subplots(1, 2)
        _draw(over_load, [(each, 40.0, f"{each:g}") for each in LOADS])
        _draw(over_temperature, [(0.0, t, f"{t:g}") for t in TEMPERATURES])
        over_load.set_ylabel("friction over largest torque; by load, at 40 °C")
        over_temperature.set_ylabel("friction over largest torque; by °C, without load")


def _draw(panel: Axes, states: list[tuple[float, float, str]]) -> None:
    for colour, (torque, temperature, label) in zip(COLOURS, states, strict=False):
        panel.semilogx(SPEEDS, published(SPEEDS, torque, temperature), color=colour, label=label)
        panel.semilogx(SPEEDS, of_element(torque, temperature), ":", color=colour, linewidth=1.8)
    plain_decades(panel)
    panel.set(xlabel="speed of the motor, rad/s", ylim=(0.0, None))
    panel.legend(ncols=3)


def main() -> None:
    """Print what load and temperature do; draw the curves where asked for."""
    options = arguments(__doc__, PLOT)
    publish(trends())
    if options.plot is not None:
        draw(options.plot)


if __name__ == "__main__":
    main()
