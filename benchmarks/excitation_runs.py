"""Excitation runs of random arms as sensors see them: noise, quantisation, ripple, load-dependent friction, jitter.

`measured(arm, FourierMotion.random(arm, seed), rate)` gives a run; `record` and `write_run` hand it on as a record or a
bag.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from benchmarks.random_arms import SyntheticArm
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.arrays import Array

if TYPE_CHECKING:
    from rx90_emulator.identification.records import JointRecord

Motion = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (m, n)."""


@dataclass(frozen=True)
class Disturbances:
    """What a model of rigid bodies and friction does not say, and errors of the sensors.

    Attributes:
        white: standard deviation of a sample of a motor's torque, in parts of its RMS torque.
        coloured: of noise of first order, in the same parts.
        corner: of that noise, Hz.
        counts: of the encoders, per motor revolution; 0 for exact positions.
        ripple: amplitude of a torque that changes with the motor's angle, in parts of the motor's RMS torque.
        load: relative change of the Coulomb torque at the joint's RMS torque: friction grows with the load.
        jitter: of the sampling times, in parts of the period.
        stamp: standard deviation of the error of a stamp, s.
    """

    white: float = 0.02
    coloured: float = 0.01
    corner: float = 5.0
    counts: float = 16384.0
    ripple: float = 0.0
    load: float = 0.0
    jitter: float = 0.02
    stamp: float = 0.0


NOISE = Disturbances()
MISFIT = Disturbances(ripple=0.02, load=0.05)
NOTHING = Disturbances(white=0.0, coloured=0.0, counts=0.0, jitter=0.0)


@dataclass(frozen=True, eq=False)
class FourierMotion:
    """A finite Fourier series, periodic, at rest at its start and end, with a rest before and behind.

        v_j(t) = sum_k a_kj cos(k w t) + b_kj sin(k w t),  sum_k a_kj = 0,  sum_k k b_kj = 0

    Attributes:
        center: middle position, rad, shape (n,).
        cosine, sine: a and b, rad/s, shape (harmonics, n).
        period: s.
        periods: how many.
        rest: before and behind, s.
    """

    center: Array
    cosine: Array
    sine: Array
    period: float
    periods: int = 2
    rest: float = 0.5

    @classmethod
    def random(
        cls,
        arm: SyntheticArm,
        seed: int,
        *,
        harmonics: int = 6,
        period: float = 12.0,
        periods: int = 2,
        speed: tuple[float, float] = (2.0, 4.0),
    ) -> FourierMotion:
        """Return a series whose joints reach speeds in this range, rad/s, and stay within a turn."""
        rng = np.random.default_rng((seed, 20))
        n = len(arm.links)
        order = np.arange(1.0, harmonics + 1.0)[:, None]
        cosine, sine = rng.normal(size=(2, harmonics, n))
        cosine -= cosine.mean(axis=0)
        sine -= order * (order * sine).sum(axis=0) / (order**2).sum()
        motion = cls(rng.uniform(-1.0, 1.0, n), cosine, sine, period, periods)
        position, velocity, _ = motion.at(motion.rest + np.linspace(0.0, period, 600))
        fastest = rng.uniform(*speed, n) / np.abs(velocity).max(axis=0)
        scale = np.minimum(fastest, 2.8 / np.abs(position - motion.center).max(axis=0))
        return cls(motion.center, cosine * scale, sine * scale, period, periods)

    @property
    def duration(self) -> float:
        """Return the time with both rests, s."""
        return self.period * self.periods + 2.0 * self.rest

    def at(self, time: Array) -> Motion:
        """Return position, velocity and acceleration at these times, s, each of shape (m, n)."""
        base = 2.0 * np.pi / self.period
        t = np.clip(time - self.rest, 0.0, self.period * self.periods)
        rate = base * np.arange(1.0, len(self.cosine) + 1.0)
        cos, sin = np.cos(np.outer(t, rate)), np.sin(np.outer(t, rate))
        position = self.center + (sin / rate) @ self.cosine - (cos / rate) @ self.sine
        moving = ((time > self.rest) & (time < self.duration - self.rest))[:, None]
        velocity = np.where(moving, cos @ self.cosine + sin @ self.sine, 0.0)
        acceleration = np.where(moving, (cos * rate) @ self.sine - (sin * rate) @ self.cosine, 0.0)
        return position, velocity, acceleration


@dataclass(frozen=True, eq=False)
class ExcitationRun:
    """One run; m samples of n joints.

    Attributes:
        time: stamps, s, shape (m,).
        reference: set-points, rad, shape (m, n), as are the following.
        position: as the encoders have it, rad.
        velocity: differences of the positions, rad/s.
        torque: as the motors' current sensors have it, at the joints, Nm.
        exact: what position, velocity and acceleration really were.
        noise: the part of the torque that no model can tell: white and coloured noise, Nm.
        ripple: the part that changes with the motors' angles, Nm.
        name: of the run.
    """

    time: Array
    reference: Array
    position: Array
    velocity: Array
    torque: Array
    exact: Motion
    noise: Array
    ripple: Array
    name: str

    def record(self, arm: SyntheticArm) -> JointRecord:
        """Return the run as it is read from a bag."""
        # logs need nothing of the identification
        from rx90_emulator.identification.records import JointRecord

        digest = hashlib.sha256(self.name.encode()).hexdigest()
        return JointRecord(
            arm.names, self.time, self.position, self.velocity, self.torque, Path(self.name), digest
        )


def torque_along(arm: SyntheticArm, time: Array, motion: Motion, load: float = 0.0) -> Array:
    """Return the joint torques of arm and friction, Nm, shape (m, n).

    Args:
        arm: with its friction.
        time: s, shape (m,), from rest.
        motion: at these times.
        load: as in `Disturbances`.
    """
    bare = arm.frictionless(*motion)
    size = np.append(arm.torque, arm.torque[-1])[: len(arm.friction)]
    carried = np.abs(np.column_stack([bare, bare[:, -1]])[:, : len(size)]) / size
    inputs = motion[1] @ arm.element_matrix.T
    laws = enumerate(arm.friction)
    elements = [law.torque(time, inputs[:, k], load * carried[:, k]) for k, law in laws]
    return np.asarray(bare + np.column_stack(elements) @ arm.element_matrix)


def measured(
    arm: SyntheticArm,
    motion: FourierMotion,
    rate: float,
    seed: int = 0,
    disturbances: Disturbances = NOISE,
) -> ExcitationRun:
    """Return what sensors make of a run at `rate` samples per second; equal arguments give equal runs."""
    rng = np.random.default_rng((seed, 30))
    d, n = disturbances, len(arm.links)
    even = np.arange(int(motion.duration * rate)) / rate
    time = even + np.clip(d.jitter * rng.normal(size=even.shape), -0.4, 0.4) / rate
    exact = motion.at(time)
    joint = torque_along(arm, time, exact, d.load)
    turns = arm.coupling
    motor_torque = np.linalg.solve(turns.T, joint.T).T
    rms = np.sqrt(np.mean(motor_torque**2, axis=0))
    noise = rms * (
        d.white * rng.normal(size=joint.shape)
        + d.coloured * _first_order(rng, d.corner / rate, joint.shape)
    )
    angle = exact[0] @ turns.T * arm.gear
    harmonic, phase = rng.choice([1.0, 2.0, 6.0], n), rng.uniform(0.0, 2.0 * np.pi, n)
    ripple = d.ripple * rms * np.sin(harmonic * angle + phase)
    position = exact[0]
    if d.counts:
        step = 2.0 * np.pi / d.counts
        counted = np.round(position @ turns.T * arm.gear / step) * step
        position = np.linalg.solve(turns, (counted / arm.gear).T).T
    stamps = time + d.stamp * rng.normal(size=time.shape)
    velocity = np.gradient(position, stamps, axis=0)
    torque = joint + (noise + ripple) @ turns
    name = f"run_{seed}"
    return ExcitationRun(
        stamps, exact[0], position, velocity, torque, exact, noise @ turns, ripple @ turns, name
    )


def _first_order(rng: np.random.Generator, corner: float, shape: tuple[int, ...]) -> Array:
    """Return noise of deviation 1 whose spectrum falls from `corner`, in parts of the sampling rate."""
    keep = np.exp(-2.0 * np.pi * corner)
    white = rng.normal(size=shape)
    white[1:] *= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))


def write_run(
    run: ExcitationRun, arm: SyntheticArm, folder: Path, *, wrong: float = 0.0
) -> tuple[Path, Path]:
    """Write a bag named as the run, and the URDF; return the names of both.

    Args:
        run: to be written, joint side, on the topic joint_states.
        arm: that it is of.
        folder: for both, made if need be.
        wrong: as in `SyntheticArm.urdf`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    urdf = folder / "arm.urdf"
    urdf.write_text(arm.urdf(wrong), encoding="utf-8")
    stamps = np.rint((run.time + 1.0) * 1e9).astype(np.int64)
    fields = {"position": run.position, "velocity": run.velocity, "effort": run.torque}
    write_joint_states(
        folder / run.name, [JointSeries("joint_states", arm.names, stamps, **fields)]
    )
    return folder / run.name, urdf
