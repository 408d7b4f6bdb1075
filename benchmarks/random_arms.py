"""Random serial arms with known parameters: links, rotors, springs, gears, wrist coupling and friction.

Pinocchio gives the rigid-body torque; friction is plain NumPy from the equations, nothing of the code under test is in
it. What excitation runs of such an arm look like is in `excitation_runs`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import solve_banded

from rx90_common.base.arrays import Array


@dataclass(frozen=True)
class FrictionLaw:
    """Coulomb, Stribeck and viscous friction with an exponent, and a bristle where `c0` is not 0.

        c0 g(v) = tau_c(sign v) (1 + rise exp(-(|v| / omega_s)^delta)) (1 + load)
        tau = sign(v) c0 g(v) + c2 |v|^alpha sign(v)                      without a bristle
        dz/dt = v - |v| / g(v) z,  tau = c0 z + c1 dz/dt + c2 |v|^alpha sign(v)      with one

    Attributes:
        tau_c: Coulomb torque for v > 0 and for v < 0, Nm.
        c2: viscous torque at 1 rad/s, Nm.
        alpha: viscous exponent.
        rise: static over Coulomb torque, less 1.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent.
        c0: bristle stiffness, Nm/rad; 0 for none.
        c1: micro-viscous damping, Nm s/rad.
    """

    tau_c: tuple[float, float]
    c2: float
    alpha: float = 1.0
    rise: float = 0.0
    omega_s: float = 0.1
    delta: float = 1.0
    c0: float = 0.0
    c1: float = 0.0

    @property
    def coulomb(self) -> float:
        """Return the mean of both Coulomb torques, Nm."""
        return sum(self.tau_c) / 2.0

    @property
    def asymmetry(self) -> float:
        """Return half the difference of the Coulomb torques, Nm: of a part without Stribeck effect a constant."""
        return (self.tau_c[0] - self.tau_c[1]) / 2.0

    def sliding(self, velocity: Array, load: Array | float = 0.0) -> Array:
        """Return c0 g(v), Nm; `load` is the relative change of the Coulomb torque."""
        coulomb = np.where(velocity >= 0.0, *self.tau_c)
        stribeck = 1.0 + self.rise * np.exp(-((np.abs(velocity) / self.omega_s) ** self.delta))
        return np.asarray(coulomb * stribeck * (1.0 + load))

    def viscous(self, velocity: Array) -> Array:
        """Return c2 |v|^alpha sign(v), Nm."""
        return np.asarray(self.c2 * np.abs(velocity) ** self.alpha * np.sign(velocity))

    def steady(self, velocity: Array, load: Array | float = 0.0) -> Array:
        """Return the torque without a bristle, Nm."""
        return np.sign(velocity) * self.sliding(velocity, load) + self.viscous(velocity)

    def torque(
        self, time: Array, velocity: Array, load: Array | float = 0.0, substeps: int = 8
    ) -> Array:
        """Return the torque along a motion from rest, Nm, all of shape (m,).

        Over a part of a step, in which the velocity keeps its middle value, equation 17 has an exponential for its
        solution; the chain of them is a bidiagonal system.
        """
        if not self.c0:
            return self.steady(velocity, load)
        fine = np.interp(
            np.arange((len(time) - 1) * substeps + 1) / substeps, np.arange(len(time)), time
        )
        middle, step = (fine[1:] + fine[:-1]) / 2.0, np.diff(fine)
        v = np.interp(middle, time, velocity)
        loaded = np.interp(middle, time, np.broadcast_to(load, time.shape))
        limit = self.sliding(v, loaded) / self.c0
        decay = np.exp(-np.abs(v) * step / limit)
        bands = np.vstack([np.ones(len(fine)), np.append(-decay, 0.0)])
        z = solve_banded((1, 0), bands, np.append(0.0, np.sign(v) * limit * (1.0 - decay)))[
            ::substeps
        ]
        rate = velocity - np.abs(velocity) * self.c0 / self.sliding(velocity, load) * z
        return self.c0 * z + self.c1 * rate + self.viscous(velocity)


_LIMITS = '<limit lower="-6.3" upper="6.3" velocity="20" effort="10000"/>'
_KEYS = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


@dataclass(frozen=True, eq=False)
class Link:
    """A link with the joint before it, SI units.

    Attributes:
        xyz, rpy: the joint's frame in that of the joint before it; it turns about z.
        mass: of the link.
        center: of mass in the joint's frame, shape (3,).
        inertia: about the centre of mass, axes of the joint's frame, shape (3, 3).
    """

    xyz: Array
    rpy: Array
    mass: float
    center: Array
    inertia: Array

    @property
    def parameters(self) -> Array:
        """Return mass, first moment and inertia about the joint in Pinocchio's order, shape (10,)."""
        return np.array(pin.Inertia(self.mass, self.center, self.inertia).toDynamicParameters())

    def urdf(self, number: int) -> str:
        """Return the XML of the joint and the link with this number."""
        inertia = " ".join(f'{key}="{float(self.inertia[i, j])!r}"' for key, i, j in _KEYS)
        return (
            f'<joint name="joint_{number}" type="revolute"><parent link="link_{number - 1}"/>'
            f'<child link="link_{number}"/><origin xyz="{_text(self.xyz)}" rpy="{_text(self.rpy)}"/>'
            f'<axis xyz="0 0 1"/>{_LIMITS}</joint>\n'
            f'<link name="link_{number}"><inertial><origin xyz="{_text(self.center)}" rpy="0 0 0"/>'
            f'<mass value="{float(self.mass)!r}"/><inertia {inertia}/></inertial></link>\n'
        )


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


@dataclass(frozen=True, eq=False)
class SyntheticArm:
    """An arm and all that is true of it; n joints, n_el = n or, with the coupled wrist, n + 1 friction elements.

    Attributes:
        links: n of them.
        rotor: rotor inertia seen through the gear, kg m^2, shape (n,).
        spring: amplitude k of a torque -k sin(q) on each joint, Nm, shape (n,).
        offset: constant torque of each joint, Nm, shape (n,).
        gear: motor turns per joint turn, negative ones among them, shape (n,).
        coupled: whether the last motor turns with the last two joints together.
        friction: a law for each element; the coupled one last.
        torque: RMS torque of each joint without friction in brisk motion, Nm, shape (n,).
    """

    links: tuple[Link, ...]
    rotor: Array
    spring: Array
    offset: Array
    gear: Array
    coupled: bool
    friction: tuple[FrictionLaw, ...]
    torque: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Return the joints' names, from base to tip."""
        return tuple(f"joint_{k + 1}" for k in range(len(self.links)))

    @property
    def coupling(self) -> Array:
        """Return motor turns for joint turns without the gears, shape (n, n)."""
        turns = np.eye(len(self.links))
        if self.coupled:
            turns[-1, -2] = 1.0
        return turns

    @property
    def element_matrix(self) -> Array:
        """Return input velocities of the friction elements for joint velocities, shape (n_el, n)."""
        n = len(self.links)
        return np.vstack([np.eye(n), self.coupling[-1:]]) if self.coupled else np.eye(n)

    @property
    def link_parameters(self) -> Array:
        """Return the links' inertial parameters in Pinocchio's order, shape (10 n,)."""
        return np.concatenate([link.parameters for link in self.links])

    @cached_property
    def model(self) -> Any:
        """Return Pinocchio's model of the joints."""
        return pin.buildModelFromXML(self.urdf())

    def urdf(self, wrong: float = 0.0, seed: int = 0) -> str:
        """Return the description; with `wrong` its masses and inertias are off by factors of about 1 +- wrong."""
        rng = np.random.default_rng(seed)
        text = '<robot name="random_arm">\n<link name="link_0"/>\n'
        for number, link in enumerate(self.links, 1):
            factor = float(np.exp(wrong * rng.normal()))
            text += replace(link, mass=link.mass * factor, inertia=link.inertia * factor).urdf(
                number
            )
        return f"{text}</robot>\n"

    def frictionless(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the joint torques of links, rotors, springs and offsets, Nm, all of shape (m, n)."""
        data = self.model.createData()
        motion = zip(position, velocity, acceleration, strict=True)
        torque = np.array([pin.rnea(self.model, data, *row) for row in motion])
        rotors = self.coupling.T @ np.diag(self.rotor) @ self.coupling
        return torque + acceleration @ rotors + self.spring * np.sin(position) + self.offset


def random_link(rng: np.random.Generator, number: int, *, square: bool) -> Link:
    """Return a link that some body has: a density's mass, mean and covariance."""
    quarter = np.pi / 2.0
    rpy = rng.choice([-quarter, 0.0, quarter], 3) if square else rng.uniform(-np.pi, np.pi, 3)
    if number == 0:
        rpy = rng.uniform(-0.3, 0.3, 3)
    elif square and not (np.abs(rpy[:2]) == quarter).any():
        rpy[0] = quarter  # axes that are all parallel excite little
    mass = 10.0 * 0.6**number * rng.uniform(0.6, 1.5)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    covariance = axes @ np.diag(rng.uniform(0.03, 0.12, 3) ** 2) @ axes.T
    inertia = mass * (np.trace(covariance) * np.eye(3) - covariance)
    return Link(rng.uniform(-0.35, 0.35, 3), rpy, mass, rng.uniform(-0.15, 0.15, 3), inertia)


def random_law(
    rng: np.random.Generator, torque: float, *, bristle: bool, stribeck: bool
) -> FrictionLaw:
    """Return friction of a size that suits a joint with this torque, Nm; that of a Staubli TX40 lies in the range."""
    coulomb, fast = torque * rng.uniform(0.1, 0.35), 3.0
    lean = rng.uniform(-0.15, 0.15) * (rng.random() < 0.5)
    alpha = rng.uniform(0.6, 1.0)
    c2 = torque * rng.uniform(0.25, 0.8) / fast**alpha
    rise = rng.uniform(0.2, 0.5) if stribeck else 0.0
    c0 = coulomb / 10 ** rng.uniform(-3.7, -2.7) if bristle else 0.0
    c1 = c0 * rng.uniform(2e-4, 1e-3)
    both = (coulomb * (1.0 + lean), coulomb * (1.0 - lean))
    return FrictionLaw(both, c2, alpha, rise, rng.uniform(0.03, 0.15), 1.0, c0, c1)


def random_arm(
    seed: int,
    joints: int | None = None,
    *,
    coupled: bool | None = None,
    bristles: bool = False,
    stribeck: bool | None = None,
) -> SyntheticArm:
    """Return an arm; equal arguments give equal arms.

    Args:
        seed: of everything random.
        joints: how many; by default 2 to 6.
        coupled: whether the last two joints form a coupled wrist; by default of every second arm.
        bristles: whether friction has bristles.
        stribeck: whether it has a Stribeck part; by default of every second element.
    """
    rng = np.random.default_rng((seed, 10))
    n = int(rng.integers(2, 7)) if joints is None else joints
    wrist = bool(rng.random() < 0.5) if coupled is None else coupled
    square = bool(rng.random() < 0.5)
    links = tuple(random_link(rng, k, square=square) for k in range(n))
    gear = rng.uniform(30.0, 120.0, n) * rng.choice([1.0, 1.0, 1.0, -1.0], n)
    zero = np.zeros(n)
    bare = SyntheticArm(links, zero, zero, zero, gear, wrist, (), zero)
    motion = rng.uniform(-1.5, 1.5, (3, 200, n)) * np.array([1.5, 1.0, 3.0])[:, None, None]
    torque = np.sqrt(np.mean(bare.frictionless(*motion) ** 2, axis=0)) + 0.3
    rotor = torque * rng.uniform(0.02, 0.08, n)
    spring = torque * rng.uniform(0.2, 0.5, n) * (rng.random(n) < 0.2)
    offset = torque * rng.uniform(-0.03, 0.03, n)
    sizes = np.append(torque, torque[-1])[: n + wrist]
    laws = tuple(
        random_law(
            rng,
            size,
            bristle=bristles,
            stribeck=rng.random() < 0.5 if stribeck is None else stribeck,
        )
        for size in sizes
    )
    return SyntheticArm(links, rotor, spring, offset, gear, wrist, laws, torque)
