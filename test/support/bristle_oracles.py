"""Bristles of other kinds than LuGre's once more, written down from the papers for a solver with located events."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.signs import SIGNS

Velocity = Callable[[float], float]
_TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}


def random_element(rng: np.random.Generator) -> FrictionElement:
    coulomb = 10.0 ** rng.uniform(0.0, 1.5, 2)
    static = coulomb * rng.uniform(1.0, 2.0, 2)
    c0 = 10.0 ** rng.uniform(3.5, 5.5)
    c1 = c0 * 10.0 ** rng.uniform(-4.0, -3.0)
    return FrictionElement(
        tau_c=dict(zip(SIGNS, coulomb, strict=True)),
        tau_s=dict(zip(SIGNS, static, strict=True)),
        omega_s=10.0 ** rng.uniform(-2.0, 0.0),
        delta=rng.uniform(0.6, 2.0),
        c0=c0,
        c1=c1,
        c2=rng.uniform(0.0, 20.0),
        omega_d=rng.choice([math.inf, 1.0]),
        alpha=rng.choice([1.0, 0.7]),
    )


@dataclass(frozen=True)
class ElastoPlasticOracle:
    """Dupont, Hayward, Armstrong, Altpeter (2002), equations of the single-state model."""

    element: FrictionElement
    break_away: float

    def limits(self, v: float) -> tuple[float, float]:
        """Return the break-away deflection and the steady one, rad, without a sign."""
        coulomb = self.element.tau_c.positive if v >= 0.0 else self.element.tau_c.negative
        c0 = self.element.c0
        return self.break_away * coulomb / c0, float(self.element.sliding_torque(v)) / c0

    def rate(self, z: float, v: float) -> float:
        """Return dz/dt, rad/s."""
        elastic, steady = self.limits(v)
        size = abs(z)
        if v * z < 0.0 or size <= elastic:
            alpha = 0.0
        elif size >= steady:
            alpha = 1.0
        else:
            alpha = 0.5 * math.sin(math.pi * (size - 0.5 * (steady + elastic)) / (steady - elastic)) + 0.5
        return v * (1.0 - alpha * size / steady)

    def torque(self, z: float, v: float) -> float:
        e = self.element
        return float(e.c0 * z + e.damping(v) * self.rate(z, v) + e.viscous_torque(v))

    def hold(self, z: float, v: float, step: float) -> tuple[float, float]:
        """Return deflection and mean torque after a step at constant velocity, kinks located."""
        unit = self.limits(v)[1]  # deflections in parts of the steady one

        def rhs(_: float, y: Array) -> list[float]:
            return [step * self.rate(unit * y[0], v) / unit, y[0]]

        def kink(_: float, y: Array) -> float:
            return float(y[0] * unit - math.copysign(self.limits(v)[0], v))

        kink.terminal = True  # type: ignore[attr-defined]
        time, y = 0.0, np.array([z / unit, 0.0])
        while time < 1.0:
            part = solve_ivp(rhs, (time, 1.0), y, events=kink if time == 0.0 else None, **_TIGHT)
            time, y = part.t[-1], part.y[:, -1]
        e = self.element
        mean_rate = (y[0] * unit - z) / step
        return float(y[0] * unit), float(e.c0 * unit * y[1] + e.damping(v) * mean_rate + e.viscous_torque(v))


@dataclass
class MaxwellSlipOracle:
    """Lampaert, Al-Bender, Swevers (2003): blocks with modes; slipping ones are loaded no faster than sticking ones."""

    element: FrictionElement
    stiffness: Array
    share: Array
    attraction: float

    def __post_init__(self) -> None:
        self.slips = np.zeros(len(self.stiffness), np.bool_)
        self.sense = 0.0

    def rates(self, forces: Array, v: float) -> Array:
        """Return the rates of the blocks' torques, Nm/s."""
        stuck = self.stiffness * self.element.c0 * v
        steady = math.copysign(float(self.element.sliding_torque(v)), v)
        slip = math.copysign(self.attraction, v) * (self.share - forces / steady)
        slip = math.copysign(1.0, v) * np.minimum(math.copysign(1.0, v) * slip, np.abs(stuck))
        return np.where(self.slips, slip, stuck)

    def torque(self, forces: Array, v: float) -> float:
        e = self.element
        rate = float(np.sum(self.rates(forces, v))) if v else 0.0
        return float(np.sum(forces) + e.damping(v) * rate / e.c0 + e.viscous_torque(v))

    def hold(self, forces: Array, v: float, step: float) -> tuple[Array, float]:
        """Return the blocks' torques and the mean torque after a step at constant velocity, events located."""
        if v * self.sense < 0.0:
            self.slips[:] = False
        self.sense = math.copysign(1.0, v)
        limit = self.share * float(self.element.sliding_torque(v))
        elastic = self.stiffness * self.element.c0 * abs(v)
        released = limit * (1.0 - elastic / (self.attraction * self.share))

        def rhs(_: float, y: Array) -> Array:
            return step * np.concatenate([self.rates(y[:-1], v), [np.sum(y[:-1])]])

        def crossing(i: int, level: float) -> Callable[[float, Array], float]:
            def left(_: float, y: Array) -> float:
                return float(self.sense * y[i] - level)

            left.terminal = True  # type: ignore[attr-defined]
            return left

        time, y = 0.0, np.append(forces, 0.0)
        while time < 1.0:
            self.slips |= self.sense * y[:-1] >= limit * (1.0 - 1e-13)
            # A sticking block will slip; the rate of a slipping one may leave its bound, which is a kink.
            level = np.where(self.slips, released, limit)
            ahead = self.sense * y[:-1] < level - 1e-12 * limit
            events = [crossing(i, level[i]) for i in np.flatnonzero(ahead)]
            part = solve_ivp(rhs, (time, 1.0), y, events=events, **_TIGHT)
            time, y = part.t[-1], part.y[:, -1]
        e = self.element
        mean_rate = float(np.sum(y[:-1] - forces)) / step / e.c0
        return y[:-1], float(y[-1] / step + e.damping(v) * mean_rate + e.viscous_torque(v))


def swing(
    oracle: ElastoPlasticOracle | MaxwellSlipOracle, inertia: float, force: Velocity, end: float, start: float
) -> tuple[float, float, int]:
    """Return where a mass with a start velocity is after a time, how fast, and its turns; kinks are located."""
    e, blocks = oracle.element, isinstance(oracle, MaxwellSlipOracle)
    count = len(oracle.stiffness) if isinstance(oracle, MaxwellSlipOracle) else 1

    def rhs(t: float, y: Array) -> Array:
        if isinstance(oracle, MaxwellSlipOracle):
            rates, friction = oracle.rates(y[2:], y[1]), oracle.torque(y[2:], y[1])
        else:
            rates = np.array([e.c0 * oracle.rate(y[2] / e.c0, y[1])])
            friction = oracle.torque(y[2] / e.c0, y[1])
        return np.concatenate([[y[1], (force(t) - friction) / inertia], rates])

    def turn(_: float, y: Array) -> float:
        return float(y[1])

    def limit(i: int) -> Callable[[float, Array], float]:
        def left(_: float, y: Array) -> float:
            if isinstance(oracle, MaxwellSlipOracle):
                return sense * y[2 + i] - oracle.share[i] * float(e.sliding_torque(y[1]))
            return sense * y[2] - e.c0 * oracle.limits(y[1])[0]

        left.terminal, left.direction = blocks, 1.0  # type: ignore[attr-defined]
        return left

    time, turns, sense, y = 0.0, 0, 1.0, np.array([0.0, start, *np.zeros(count)])
    while time < end:
        turn.terminal, turn.direction = True, -sense  # type: ignore[attr-defined]
        waiting = [i for i in range(count) if not (isinstance(oracle, MaxwellSlipOracle) and oracle.slips[i])]
        part = solve_ivp(
            rhs, (time, end), y, "DOP853", rtol=1e-10, atol=[1e-13, 1e-11, *[1e-9] * count],
            events=[turn, *map(limit, waiting)],
        )  # fmt: skip
        time, y = part.t[-1], part.y[:, -1]
        if part.t_events[0].size:
            turns, sense = turns + 1, -sense
            y[1] = sense * 1e-13
            if isinstance(oracle, MaxwellSlipOracle):
                oracle.slips[:] = False
        elif isinstance(oracle, MaxwellSlipOracle):
            for i, found in zip(waiting, part.t_events[1:], strict=True):
                oracle.slips[i] |= found.size > 0
    return float(y[0]), float(y[1]), turns
