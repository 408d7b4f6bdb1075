"""Friction of a robot joint over speed, load and temperature as published, and as an element of this project has it.

    python -m benchmarks.published_friction [--plot docs/images/published_friction.png]

Bittencourt and Gunnarsson (2012), Static Friction in a Robot Joint - Modeling and Identification of Load and
Temperature Effects, J. Dyn. Sys. Meas. Control 134(5) 051013: load and temperature change a joint's Stribeck curve.
Torques are shares of the joint's largest torque, speeds the motor's. Their numbers are those that Yan, Li and Meng
(2020), Proc. IMechE J, doi 10.1177/1350650120954943, carry on (github.com/qiyan98/Manipulator-dynamics, FunFriction.m).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.report import merge, print_table
from rx90_common.base.arrays import Array
from rx90_common.friction.element import FrictionElement
from rx90_common.report.plot import COLOURS, Curve, Panel, Plot
from rx90_common.report.still import write_picture

COULOMB, COULOMB_LOAD = 3.11e-2, 2.34e-2
STATIC_LOAD, SPEED_LOAD = 1.26e-1, 9.22  # of the load: Stribeck torque, and its speed in rad/s
STATIC, STATIC_TEMPERATURE = -2.50e-2, 1.60e-3  # without load: Stribeck torque at 0 degrees Celsius, and by degree
SPEED, SPEED_TEMPERATURE = -24.81, 0.98  # its speed, rad/s, the same
EXPONENT = 1.36
VISCOUS, VISCOUS_TEMPERATURE, TEMPERATURE_SCALE = 1.30e-4, 1.32e-3, 20.71  # s/rad, s/rad, degrees Celsius

LOADS = (0.0, 0.2, 0.4, 0.6, 0.8)
TEMPERATURES = (30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
SAME_SPEED = (SPEED_LOAD - SPEED) / SPEED_TEMPERATURE
"""The temperature at which both Stribeck speeds are the same, degrees Celsius."""
SPEEDS = np.geomspace(0.1, 280.0, 400)


def published(speed: Array, load: float, temperature: float) -> Array:
    """Return the friction of the paper's model for speeds above 0, rad/s."""
    of_load = STATIC_LOAD * load * np.exp(-((speed / SPEED_LOAD) ** EXPONENT))
    stribeck_speed = SPEED + SPEED_TEMPERATURE * temperature
    stribeck = (STATIC + STATIC_TEMPERATURE * temperature) * np.exp(-((speed / stribeck_speed) ** EXPONENT))
    viscous = VISCOUS + VISCOUS_TEMPERATURE * np.exp(-temperature / TEMPERATURE_SCALE)
    return np.asarray(COULOMB + COULOMB_LOAD * load + of_load + stribeck + viscous * speed)


def element_at(load: float, temperature: float) -> FrictionElement:
    """Return the element that a load and a temperature come to: one Stribeck speed, for both of its shares."""
    coulomb = COULOMB + COULOMB_LOAD * load
    static = coulomb + STATIC_LOAD * load + STATIC + STATIC_TEMPERATURE * temperature
    viscous = VISCOUS + VISCOUS_TEMPERATURE * float(np.exp(-temperature / TEMPERATURE_SCALE))
    speed = SPEED + SPEED_TEMPERATURE * temperature
    return FrictionElement(coulomb, coulomb, static, static, speed, EXPONENT, 1.0, 0.0, viscous)


def trends() -> dict[str, float]:
    """Return what load and temperature do, and how far the element is from the paper, as figures."""
    slow, fast = np.array([1.0]), np.array([200.0])

    def ratio(speed: Array, first: tuple[float, float], second: tuple[float, float]) -> float:
        """Return friction at the second load and temperature over that at the first."""
        return float((published(speed, *second) / published(speed, *first))[0])

    minimum = [float(SPEEDS[np.argmin(published(SPEEDS, 0.0, t))]) for t in (30.0, 80.0)]
    return {
        "published_friction_load_slow": ratio(slow, (0.0, 40.0), (0.8, 40.0)),
        "published_friction_load_fast": ratio(fast, (0.0, 40.0), (0.8, 40.0)),
        "published_friction_hot_slow": ratio(slow, (0.0, 30.0), (0.0, 80.0)),
        "published_friction_hot_fast": ratio(fast, (0.0, 30.0), (0.0, 80.0)),
        "published_friction_minimum_cold": minimum[0],
        "published_friction_minimum_hot": minimum[1],
        "published_friction_error_temperature": max(error(0.0, t) for t in TEMPERATURES),
        "published_friction_error_load": max(error(load, SAME_SPEED) for load in LOADS),
        "published_friction_error_both": max(error(load, t) for load in LOADS for t in TEMPERATURES),
    }


def error(load: float, temperature: float) -> float:
    """Return the largest deviation of the element from the paper over all speeds, as a share of the paper's value."""
    ours, theirs = element_at(load, temperature).steady_torque(SPEEDS), published(SPEEDS, load, temperature)
    return float(np.max(np.abs(ours / theirs - 1.0)))


def plot() -> Plot:
    """Return curves over speed, for loads at 40 degrees and for temperatures without load; published ones are solid."""
    over_load = list(_curves([(load, 40.0, f"{load:g}") for load in LOADS]))
    over_temperature = list(_curves([(0.0, t, f"{t:g}") for t in TEMPERATURES]))
    x, y = "speed of the motor, rad/s", "friction over largest torque"
    return Plot(
        [
            Panel(over_load, "", x, f"{y}; by load, at 40 °C", x_scale="log", from_zero=True),
            Panel(over_temperature, "", x, f"{y}; by °C, without load", x_scale="log", from_zero=True),
        ],
        columns=2,
        height=3.6,
    )


def _curves(states: list[tuple[float, float, str]]) -> Iterator[Curve]:
    for k, (load, temperature, label) in enumerate(states):
        yield Curve(SPEEDS, published(SPEEDS, load, temperature), label, COLOURS[k])
        yield Curve(SPEEDS, element_at(load, temperature).steady_torque(SPEEDS), "", COLOURS[k], 1.8, "dotted")


def main() -> None:
    """Print what load and temperature do; draw the curves where asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.published_friction")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curves")
    options = parser.parse_args()
    figures = trends()
    print_table(("", "value"), [(name.removeprefix("published_friction_"), f"{v:.4g}") for name, v in figures.items()])
    merge(figures)
    if options.plot is not None:
        write_picture(plot(), options.plot)


if __name__ == "__main__":
    main()
