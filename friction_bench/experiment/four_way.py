"""The source's comparison: rig, block diagram, multibody model and closed form of one ramp test.

The source compares its experiment with Simulink (equation 3 as a block diagram) and ADAMS (a multibody model) and
solves the equation in Maple. Neither program is available here; their models of Coulomb friction are:

- block diagram: a sign block gives +1, 0 and -1, so that friction is off at a velocity of exactly 0 and switches on
  with the first motion, and a fixed-step solver, which cannot meet the zero, lets the shaft chatter about it;
- multibody: a revolute joint in Pinocchio behind its gear, whose friction is a smooth function of the slip velocity, so
  that a joint that should rest creeps;
- closed form: the shaft rests until break-away and slides from then on.

All are driven by the experiment's ramp; the models also by the block diagram's own input, slope 1 from 2 s on.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from friction_bench.experiment.record import RampModel, RampRecord
from rx90_common.base.arrays import Array, Mask, rms
from rx90_common.kernels.compiled import kernel

EXPERIMENT = "experiment"
BLOCK = "block diagram"
MULTIBODY = "multibody"
CLOSED = "closed form"
SOURCE_BANDS = {
    frozenset((BLOCK, MULTIBODY)): 2.0,
    frozenset((EXPERIMENT, MULTIBODY)): 7.0,
    frozenset((EXPERIMENT, BLOCK)): 10.0,
}
"""The source's differences, per cent: Simulink and ADAMS, experiment and ADAMS, experiment and Simulink."""
SMOOTHING = 5
"""Readings over which the experiment's velocity is averaged: one count in 20 ms is 0.62 rad/s."""
SOURCE_SLOPE, SOURCE_START = 1.0, 2.0
"""Slope, Nm/s, and start, s, of the block diagram's ramp."""
FIXED_STEP = 1e-4
"""Longest step of the block diagram's solver, s, which the source does not give (assumed)."""
STABLE = 0.25
"""Longest step in time constants: an explicit solver is unstable beyond 2.5."""
STICTION = 0.1
"""ADAMS's STICTION_TRANSITION_VELOCITY, its default with its default pin radius of 1, rad/s at the joint (assumed)."""
DYNAMIC = 1.5
"""Over it, the velocity from which a joint of ADAMS has dynamic friction."""
SETTLED = 0.2
"""After break-away, s: from then on a difference is one of sliding."""


class Pair(NamedTuple):
    """The difference of two velocities, per cent of the closed form's final velocity.

    Attributes:
        worst, rms: over the whole ramp.
        sliding: the worst from SETTLED after break-away on.
        band: the source's figure for this pair, per cent, None if it gives none.
    """

    first: str
    second: str
    worst: float
    rms: float
    sliding: float
    band: float | None

    @property
    def within(self) -> bool:
        """Return whether the difference stays within the source's band."""
        return self.band is None or self.worst <= self.band


class Sensor(NamedTuple):
    """The outputs of the block diagram's joint sensor, at the motor, each shape (n,).

    Time s, position rad, velocity rad/s, acceleration rad/s², and reaction torque Nm: the torque on the joint's base
    about the axis, drive less friction, tau - f = J q'' (equation 1).
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    reaction: Array


class FourWay(NamedTuple):
    """Velocities of one ramp, motor side: time s, shape (n,), and rad/s by name, each of shape (n,).

    Attributes:
        as_source: the sensor's signals under slope 1 from 2 s on, to the torque at which the experiment's ramp ends.
        source_velocities: of the three models there, at the sensor's times.
        source_pairs: their differences.
    """

    time: Array
    velocities: dict[str, Array]
    pairs: list[Pair]
    as_source: Sensor
    source_velocities: dict[str, Array]
    source_pairs: list[Pair]


@kernel
def _net(drive: float, speed: float, coulomb: float, viscous: float) -> float:
    """Return drive less friction, Nm, with a sign block."""
    sign = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else 0.0
    return drive - viscous * speed - coulomb * sign


@kernel
def _fixed_steps(
    slope: float,
    begin: float,
    friction: tuple[float, float],
    inertia: float,
    step: float,
    count: int,
) -> Array:
    """Integrate by Bogacki and Shampine's third-order steps (Simulink's ode3); see `block_diagram`."""
    coulomb, viscous = friction
    found = np.empty((4, count))
    angle = speed = 0.0
    for k in range(count):
        t = k * step - begin
        drive = slope * max(t, 0.0)
        net = _net(drive, speed, coulomb, viscous)
        a1 = net / inertia
        found[:, k] = angle, speed, a1, net
        v2 = speed + step / 2.0 * a1
        a2 = _net(slope * max(t + step / 2.0, 0.0), v2, coulomb, viscous) / inertia
        v3 = speed + 0.75 * step * a2
        a3 = _net(slope * max(t + 0.75 * step, 0.0), v3, coulomb, viscous) / inertia
        angle += step * (2.0 * speed + 3.0 * v2 + 4.0 * v3) / 9.0
        speed += step * (2.0 * a1 + 3.0 * a2 + 4.0 * a3) / 9.0
    return found


def block_diagram(model: RampModel, start: float, time: Array, step: float = FIXED_STEP) -> Sensor:
    """Return the sensor's signals of J w' = tau - f_v w - f_c sgn w from rest: ramp, sign block and integrators.

    Args:
        model: friction, inertia and slope; the diagram has no static friction.
        start: of the ramp, s.
        time: at which the sensor is read, s, increasing from 0 or later, shape (n,).
        step: of the solver, s; made shorter where an explicit solver would not be stable.
    """
    step = min(step, STABLE * model.time_constant)
    count = int(np.ceil(time[-1] / step)) + 2
    found = _fixed_steps(
        model.slope, start, (model.coulomb, model.viscous), model.inertia, step, count
    )
    # the scope shows the solver's last step, not a line between two
    at = np.rint(time / step).astype(int)
    return Sensor(time, *found[:, at])


def smooth_friction(velocity: float, static: float, dynamic: float) -> float:
    """Return ADAMS's friction of a slip velocity: STEP from -static to static, then from static to dynamic friction.

    STEP is the cubic between two points, flat at both. This is how Adams describes its contacts; DYNAMIC is of its
    joints, whose stiction also has a spring of small deformation, left out here.
    """
    speed = abs(velocity)
    if speed < STICTION:
        x = (velocity + STICTION) / (2.0 * STICTION)
        return static * (2.0 * x * x * (3.0 - 2.0 * x) - 1.0)
    x = min((speed / STICTION - 1.0) / (DYNAMIC - 1.0), 1.0)
    return float(np.copysign(static + (dynamic - static) * x * x * (3.0 - 2.0 * x), velocity))


def simulate_multibody(model: RampModel, start: float, ratio: float, time: Array) -> Array:
    """Return the motor's velocity, rad/s, of a revolute joint about z behind a gear, from rest.

    A disc on the load shaft holds half of the inertia and the geared rotor the other half, so that both ways in which
    a multibody program holds inertia take part in the articulated-body algorithm. Integrated by backward differences.

    Args:
        model: friction, with the release as static friction, inertia and slope, at the motor.
        start: of the ramp, s.
        ratio: of the gear.
        time: s, increasing from 0 or later, shape (n,).
    """
    joint = pin.Model()
    joint.gravity = pin.Motion.Zero()
    joint.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "revolute")
    spin = model.inertia / 2 * ratio**2
    joint.appendBodyToJoint(
        1, pin.Inertia(1.0, np.zeros(3), np.diag([spin / 2, spin / 2, spin])), pin.SE3.Identity()
    )
    joint.armature = np.array([spin])
    data = joint.createData()
    static = model.coulomb + model.release

    def acceleration(t: float, state: Array) -> list[float]:
        """Return the joint's acceleration, rad/s²."""
        speed = float(state[0])
        torque = model.slope * max(t - start, 0.0) - model.viscous * speed * ratio
        torque -= smooth_friction(speed, static, model.coulomb)
        return [float(pin.aba(joint, data, np.zeros(1), state, np.array([torque * ratio]))[0])]

    last = float(time[-1])
    found = [np.zeros(int(np.sum(time <= start)))]
    moving = time[time > start]
    if moving.size:
        solution = solve_ivp(
            acceleration, (start, last), [0.0], "BDF", moving, rtol=1e-6, atol=1e-8
        )
        found.append(ratio * solution.y[0])
    return np.concatenate(found)


def measured_velocity(record: RampRecord) -> tuple[Array, Array]:
    """Return times and mean velocities of a record, differences over SMOOTHING readings, each shape (n,)."""
    time = record.time - record.origin
    width = min(SMOOTHING, time.size - 1)
    velocity = (record.angle[width:] - record.angle[:-width]) / (time[width:] - time[:-width])
    return (time[width:] + time[:-width]) / 2, velocity


def _pairs(velocities: dict[str, Array], slides: Mask) -> list[Pair]:
    """Return the differences of all pairs; `slides` marks the times at which the shaft slides."""
    final = float(velocities[CLOSED][-1])
    pairs = []
    for first, second in combinations(velocities, 2):
        difference = 100.0 * np.abs(velocities[first] - velocities[second]) / final
        worst = float(difference.max())
        sliding = float(difference[slides].max(initial=0.0))
        band = SOURCE_BANDS.get(frozenset((first, second)))
        pairs.append(Pair(first, second, worst, rms(difference), sliding, band))
    return pairs


def _models(
    model: RampModel, start: float, ratio: float, time: Array
) -> tuple[Sensor, dict[str, Array]]:
    """Return the block diagram's sensor and the velocities of the three models."""
    sensor = block_diagram(model, start, time)
    multibody = simulate_multibody(model, start, ratio, time)
    return sensor, {
        BLOCK: sensor.velocity,
        MULTIBODY: multibody,
        CLOSED: model.velocity(time - start),
    }


def compare(record: RampRecord, model: RampModel, ratio: float) -> FourWay:
    """Compare one ramp with the three models of the identified friction.

    Args:
        record: the experiment.
        model: friction and inertia at the motor, with the record's slope.
        ratio: of the gear.
    """
    time, experiment = measured_velocity(record)
    keep = time > 0.0
    time = time[keep]
    velocities = {EXPERIMENT: experiment[keep], **_models(model, 0.0, ratio, time)[1]}
    pairs = _pairs(velocities, time > model.break_away_time + SETTLED)
    source = RampModel(model.coulomb, model.viscous, model.inertia, SOURCE_SLOPE, model.release)
    end = SOURCE_START + model.slope * float(time[-1]) / SOURCE_SLOPE
    own = np.arange(0.0, end, record.tick / 4)
    sensor, by_source = _models(source, SOURCE_START, ratio, own)
    slides = own > SOURCE_START + source.break_away_time + SETTLED
    return FourWay(time, velocities, pairs, sensor, by_source, _pairs(by_source, slides))
