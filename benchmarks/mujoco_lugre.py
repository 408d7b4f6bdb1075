"""MuJoCo beside this project: the same arm, and one joint with its LuGre friction (`dcmotor` with `lugre`).

    python -m benchmarks.mujoco_lugre

A rotor is driven by the same torques, held over the same ticks of 250 us, in the plant, in MuJoCo (with its default
integrator and with `implicitfast`) and by a stiff variable-step solver. MuJoCo has one friction torque for both
signs of the velocity, a Stribeck exponent of 2 and a constant c1, so the element has them here, too.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from benchmarks.hybrid_reference import StiffPlant, decoupled_setup
from benchmarks.report import print_table
from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_emulator.export.export import export_robot
from rx90_emulator.loop.setup import Setup

_NO_MOTOR = (1e-9, 1e-9)  # motor constants of an actuator that is there for its friction alone


def mujoco_arm(setup: Setup) -> Any:
    """Return the MuJoCo model of an export; its controls are the motor torques, Nm, shape (6,)."""
    held = tuple(as_in_mujoco(one) for one in setup.friction.elements)
    setup = dataclasses.replace(setup, friction=dataclasses.replace(setup.friction, elements=held))
    return mujoco.MjModel.from_xml_string(*export_robot(setup, "mujoco").files.values())


def as_in_mujoco(element: FrictionElement) -> FrictionElement:
    """Return an element with what MuJoCo can hold of it."""
    return element.replaced(
        tau_c=element.tau_c.positive,
        tau_s=element.tau_s.positive,
        delta=2.0,
        omega_d=math.inf,
    )


def _add_friction(actuator: Any, element: FrictionElement) -> None:
    lugre = [
        element.c0,
        element.c1,
        element.tau_c.positive,
        element.tau_s.positive,
        element.omega_s,
    ]
    actuator.set_to_dcmotor(
        motorconst=_NO_MOTOR, resistance=1.0, lugre=lugre, ctrlspec=mujoco.mjtCtrlInput.mjINPUT_NONE
    )
    actuator.damping[0] = element.c2


def mass_and_bias(model: Any, data: Any, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Return M, shape (6, 6), and h with gravity and spring, shape (6,), as MuJoCo computes them."""
    data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = q, v, 0.0, 0.0
    mujoco.mj_forward(model, data)
    mass = np.empty((6, 6))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_bias - data.qfrc_spring


INERTIA = 11.0
"""Of joint 1 with the arm stretched out, kg m^2."""
_FINE = 16
_TOLERANCE = 1e-11


class States(NamedTuple):
    """Position rad, velocity rad/s and bristle deflection rad after each tick, shape (n,)."""

    q: Array
    v: Array
    z: Array


class Scenario(NamedTuple):
    """What is asked of the joint: a name, a torque in Nm as a function of time in s, and a duration in s."""

    name: str
    torque: Callable[[float], float]
    duration: float

    def torques(self, period: float) -> Array:
        """Return the torque held over each tick."""
        return np.array([self.torque(k * period) for k in range(round(self.duration / period))])


SCENARIOS = (
    Scenario("sliding", lambda t: 60.0 * min(1.0, t / 0.1), 1.0),
    Scenario("presliding", lambda t: 20.0 * math.sin(4.0 * math.pi * t), 1.0),
    Scenario("reversal", lambda t: 60.0 * math.sin(2.0 * math.pi * t), 2.0),
    Scenario("stick", lambda t: 50.0 if t < 0.3 else 10.0, 1.5),
)


def run_plant(setup: Setup, torques: Array, substeps: int = 1) -> States:
    """Run the plant step of a decoupled setup, joint 1."""
    plant = setup.plant(substeps)
    rows, command = [], np.zeros(6)
    for command[0] in torques:
        plant.step(command)
        state = plant.state[0]
        rows.append((state["q"][0], state["v"][0], state["z"][0]))
    return States(*np.array(rows).T)


def run_solver(setup: Setup, torques: Array) -> States:
    """Run a decoupled setup through the stiff solver, joint 1."""
    stiff = StiffPlant(setup, setup.plant(), _TOLERANCE)
    rows, command = [], np.zeros(6)
    for command[0] in torques:
        stiff.step(command)
        rows.append(stiff.y[[0, 6, 12]])
    return States(*np.array(rows).T)


def mujoco_joint(
    element: FrictionElement,
    period: float,
    integrator: mujoco.mjtIntegrator = mujoco.mjtIntegrator.mjINT_EULER,
) -> mujoco.MjModel:
    """Return a rotor with MuJoCo's LuGre friction."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = period, integrator
    spec.option.gravity = np.zeros(3)
    body = spec.worldbody.add_body(mass=1e-9, inertia=[1e-9] * 3, explicitinertial=True)
    joint = body.add_joint(
        name="joint", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], armature=INERTIA
    )
    friction = spec.add_actuator(
        name="friction", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    _add_friction(friction, element)
    return spec.compile()


def run_mujoco(
    element: FrictionElement,
    period: float,
    torques: Array,
    substeps: int = 1,
    integrator: mujoco.mjtIntegrator = mujoco.mjtIntegrator.mjINT_EULER,
) -> States:
    """Run MuJoCo's joint with `substeps` of its steps in a tick."""
    model = mujoco_joint(element, period / substeps, integrator)
    data, rows = mujoco.MjData(model), []
    for torque in torques:
        data.qfrc_applied[0] = torque
        mujoco.mj_step(model, data, nstep=substeps)
        rows.append((data.qpos[0], data.qvel[0], data.act[0]))
    return States(*np.array(rows).T)


def miss(a: States, b: States) -> tuple[float, float, float]:
    """Return the worst differences of position, velocity and bristle deflection."""
    return tuple(float(np.abs(x - y).max()) for x, y in zip(a, b, strict=True))  # type: ignore[return-value]


def main() -> int:
    """Run all scenarios and print who is how far from whom."""
    shipped = Setup.load()
    element, period = as_in_mujoco(shipped.friction.elements[0]), shipped.rates.period
    setup = decoupled_setup(shipped, (element,), INERTIA)
    implicit = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    rows = []
    for scenario in SCENARIOS:
        torques = scenario.torques(period)
        exact, ours = run_solver(setup, torques), run_plant(setup, torques)
        theirs = run_mujoco(element, period, torques)
        pairs = {
            "this project - solver": (ours, exact),
            "MuJoCo Euler - solver": (theirs, exact),
            "MuJoCo implicitfast - solver": (
                run_mujoco(element, period, torques, 1, implicit),
                exact,
            ),
            f"MuJoCo Euler, {_FINE} steps - solver": (
                run_mujoco(element, period, torques, _FINE),
                exact,
            ),
            "this project - MuJoCo Euler": (ours, theirs),
        }
        largest = (f"{np.abs(x).max():.3g}" for x in exact)
        rows.append((f"{scenario.name}: largest value", *largest))
        rows += [(f"  {name}", *(f"{x:.1e}" for x in miss(*pair))) for name, pair in pairs.items()]
    print_table(("one joint, 250 us", "q rad", "v rad/s", "z rad"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
