"""Friction elements with parts: what they cost, and how their step converges.

    python -m benchmarks.friction_parts

Speed: the reference line without recording of the 4 kHz series, with the same parts in all seven elements, and with
them in the controller's model of arm and friction as well; all take turns, and times are CPU times of the one thread
that works. Convergence: the whole arm with a load part in each
element, and a ripple in three, under motor torques that jump and reverse the motion, against SciPy's Radau on the same
law in continuous time, written out once more.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.hybrid_reference import Work
from benchmarks.report import in_turns, merge, print_table, print_times, ratios, timed
from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

ROUNDS = 25
POSE = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
INPUT = np.vstack([np.eye(6), [0, 0, 0, 0, 1, 1]])
"""Input velocities of the elements for joint velocities."""
THROUGH = np.vstack([np.eye(6), [0, 0, 0, 0, 0, 1]])
THROUGH[4, 5] = -1
"""Torques that go through the elements for those of the joints: all of joint 6 goes through motor 6, past motor 5."""
STEPS = np.array([1, 2, 4, 8])
_LOAD, _SCATTER = (
    LoadPart(driving=0.05, driven=0.08),
    ScatterPart(deviation=0.02, correlation_time=10.0),
)
_WARM = TemperaturePart(
    reference=40.0,
    lowest=20.0,
    highest=90.0,
    start=25.0,
    ambient=20.0,
    capacity=9000.0,
    resistance=0.4,
    viscous_scale=20.7,
    viscous_floor=0.3,
    speed_slope=0.03,
    static_slope=0.02,
)
_RIPPLE = RipplePart(motor_harmonic=(2.0,), motor_amplitude=(0.05,))
_ALL_WARM = {"load": _LOAD, "temperature": _WARM, "alpha": 0.7}


class Case(NamedTuple):
    """What all elements have, and whether the controller feeds forward by a model of the arm with the same friction."""

    values: dict[str, Any]
    known: bool = False


CASES = {
    "no part": Case({}),
    "load": Case({"load": _LOAD}),
    "load and viscous exponent": Case({"load": _LOAD, "alpha": 0.7}),
    "load, temperature, viscous exponent": Case(_ALL_WARM),
    "ripple": Case({"ripple": _RIPPLE}),
    "scatter": Case({"scatter": _SCATTER}),
    "load, ripple, scatter": Case({"load": _LOAD, "ripple": _RIPPLE, "scatter": _SCATTER}),
    "no part, and the controller's model": Case({}, known=True),
    "load, in the controller's model, too": Case({"load": _LOAD}, known=True),
    "load, temperature, viscous exponent, in the controller's model, too": Case(
        _ALL_WARM, known=True
    ),
}
_KEYS = {
    "load": "parts_load",
    "load and viscous exponent": "parts_load_exponent",
    "load, temperature, viscous exponent": "parts_load_temperature_exponent",
    "load, ripple, scatter": "parts_all",
    "no part, and the controller's model": "parts_none_known",
    "load, in the controller's model, too": "parts_load_known",
    "load, temperature, viscous exponent, in the controller's model, too": "parts_load_temperature_exponent_known",
}


def with_elements(setup: Setup, **values: Any) -> Setup:
    """Return a setup whose elements all have these values."""
    elements = tuple(element.replaced(**values) for element in setup.friction.elements)
    return replace(setup, friction=replace(setup.friction, elements=elements))


def knowing(setup: Setup, file: Path) -> Setup:
    """Return a setup whose controller feeds forward by a model with the setup's friction, written to a file."""
    elements = dict(zip(setup.friction.names, setup.friction.elements, strict=True))
    file.write_text(FrictionFile(elements=elements).text(), encoding="utf-8")
    own = setup.controller
    assert own.model is not None
    switches = {"inverse_dynamics": True, "friction_model": True}
    return replace(setup, controller=own.replaced(model={"friction": file}, feed_forward=switches))


def setup_of(case: Case, shipped: Setup, file: Path) -> Setup:
    """Return the setup of a case; what its controller knows is written to a file."""
    setup = with_elements(shipped, **case.values)
    return knowing(setup, file) if case.known else setup


def speed(rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Return the seconds per tick of all rounds, by case."""
    work = Work.load()
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"friction_{number}.yaml" for number in range(len(CASES))]
        setups = {
            name: setup_of(case, work.setup, file)
            for (name, case), file in zip(CASES.items(), files, strict=True)
        }
        ticks = work.duration * work.setup.rates.base_hz
        runs = {
            name: timed(lambda one=one: work.run(one), ticks)  # type: ignore[misc]
            for name, one in setups.items()
        }
        return in_turns(runs, rounds)


def loaded(shipped: Setup) -> Setup:
    """Return the arm with a load part in every element, each with other values, and a ripple in three."""
    ripple = RipplePart(
        joint_harmonic=(1.0,),
        joint_amplitude=(0.2,),
        joint_phase=(0.4,),
        motor_harmonic=(2.0,),
        motor_amplitude=(0.15,),
        motor_phase=(1.0,),
    )
    elements = []
    for i, element in enumerate(shipped.friction.elements):
        part = LoadPart(
            driving=0.05 + 0.02 * i,
            driven=0.3 - 0.02 * i,
            stribeck_driving=0.1,
            stribeck_driven=0.05,
            quadratic_driving=1e-3,
            quadratic_driven=2e-3,
            relax_time=1e-3 * (1 + i % 3),
        )
        elements.append(element.replaced(load=part, ripple=ripple if i % 2 else None))
    return replace(shipped, friction=replace(shipped.friction, elements=tuple(elements)))


@dataclass(frozen=True)
class StiffArm:
    """The arm by Pinocchio with the elements' law in continuous time: state (q, v, z, transmitted), shape (26,)."""

    setup: Setup

    def solve(self, state: Array, motor: Array, duration: float, tolerance: float = 1e-8) -> Array:
        """Return the state after a time of constant motor torques, Nm, shape (6,)."""
        drive = INPUT[[0, 1, 2, 3, 4, 6]].T @ (self.setup.drives.gear * motor)
        rotors = self.setup.drives.rotor_matrix
        relax = self._of_load("relax_time")

        def rates(_: float, y: Array) -> Array:
            q, v, z, transmitted = y[:6], y[6:12], y[12:19], y[19:]
            z_dot, friction = self._friction(INPUT @ q, INPUT @ v, z, transmitted)
            inputs = (np.tile(x, (7, 1)) for x in (q, v))
            answers = rigid_torque(
                self.setup.robot.model,
                rotors,
                self.setup.drives.spring_torque,
                *inputs,
                np.eye(7, 6, -1),
            )
            torque = drive - INPUT.T @ friction
            acceleration = np.linalg.solve((answers[1:] - answers[0]).T, torque - answers[0])
            through = THROUGH @ (torque - rotors @ acceleration)
            return np.concatenate([v, acceleration, z_dot, (through - transmitted) / relax])

        result = solve_ivp(
            rates, (0.0, duration), state, "Radau", rtol=tolerance, atol=tolerance * 1e-2
        )
        if not result.success:
            raise RuntimeError(f"the stiff solver gave up: {result.message}")
        return np.asarray(result.y[:, -1])

    def _friction(self, angle: Array, v: Array, z: Array, load: Array) -> tuple[Array, Array]:
        """Return the rate of the bristles and the torque of the elements, equations 17 to 19 with the parts."""
        tau_c, tau_s = (
            (1 + self._waves(angle))
            * np.where(v >= 0, self._of(f"{name}_positive"), self._of(f"{name}_negative"))
            for name in ("tau_c", "tau_s")
        )
        lifting, size = load * v >= 0, np.abs(load)
        k, s, m = (
            np.where(lifting, self._of_load(f"{name}driving"), self._of_load(f"{name}driven"))
            for name in ("", "stribeck_", "quadratic_")
        )
        tau_c, tau_s = tau_c + k * size, tau_s + (k + s) * size + m * size**2
        fading = np.exp(-((np.abs(v) / self._of("omega_s")) ** self._of("delta")))
        z_dot = v - np.abs(v) * self._of("c0") * z / (tau_c + (tau_s - tau_c) * fading)
        c1 = self._of("c1") * np.exp(-((v / self._of("omega_d")) ** 2))
        return z_dot, self._of("c0") * z + c1 * z_dot + self._of("c2") * v

    def _waves(self, angle: Array) -> Array:
        turns = [*self.setup.drives.gear, self.setup.drives.gear[5]]
        waves = np.zeros(7)
        for i, element in enumerate(self._elements):
            for at, part in (
                ((angle[i], "joint"), (turns[i] * angle[i], "motor")) if element.ripple else ()
            ):
                h, a, p = (np.array(getattr(element.ripple, f"{part}_{what}")) for what in
                           ("harmonic", "amplitude", "phase"))  # fmt: skip
                waves[i] += np.sum(a * np.cos(h * at + p))
        return waves

    @property
    def _elements(self) -> tuple[FrictionElement, ...]:
        return self.setup.friction.elements

    def _of(self, name: str) -> Array:
        return np.array([element.parameters[name] for element in self._elements])

    def _of_load(self, name: str) -> Array:
        return np.array([getattr(element.load, name) for element in self._elements])


def snapshot(plant: Plant) -> Array:
    """Return (q, v, z, transmitted), shape (26,)."""
    state = plant.state[0]
    return np.concatenate([state["q"], state["v"], state["z"], state["parts"]["load"]["torque"]])


def convergence(setup: Setup, ticks: int = 40) -> Array:
    """Return the largest errors of q, v, z and the transmitted torque, for each of STEPS in a tick, shape (4, 4)."""
    rng = np.random.default_rng(1)
    pieces = [part * setup.drives.peak_torque for part in rng.uniform(-0.5, 0.5, (2, 6))]
    plant = setup.plant()
    plant.reset(POSE)
    stiff, state, want = StiffArm(setup), snapshot(plant), []
    for motor in pieces:
        state = stiff.solve(state, motor, ticks * setup.rates.period)
        want.append(state)
    errors = []
    for substeps in STEPS:
        plant, got = setup.plant(int(substeps)), []
        plant.reset(POSE)
        for motor in pieces:
            for _ in range(ticks):
                plant.step(motor)
            got.append(snapshot(plant))
        miss = np.abs(np.array(got) - want)
        errors.append([miss[:, a:b].max() for a, b in ((0, 6), (6, 12), (12, 19), (19, 26))])
    return np.array(errors)


def main() -> int:
    """Measure, print the tables and merge the figures."""
    times = speed()
    period = Setup.load().rates.period
    ratio = ratios(times, "no part")
    median = print_times("in all seven elements", times, "no part", period)
    errors = convergence(loaded(Setup.load()))
    orders = np.vstack([np.full(4, np.nan), np.log2(errors[:-1] / errors[1:])])
    print()
    print_table(
        (
            "steps in a tick",
            "joints, µrad",
            "order",
            "mrad/s",
            "order",
            "bristles, µrad",
            "order",
            "load, Nm",
            "order",
        ),
        [
            (
                str(n),
                *(
                    text
                    for i in range(4)
                    for text in (f"{row[i] * scale[i]:.3g}", f"{order[i]:.2f}")
                ),
            )
            for n, row, order in zip(STEPS, errors, orders, strict=True)
            for scale in [(1e6, 1e3, 1e6, 1.0)]
        ],
    )
    merge({f"{key}_real_time_factor": period / median[name] for name, key in _KEYS.items()})
    merge({f"{key}_cost": ratio[name] for name, key in _KEYS.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
