"""Logs of an emulated arm, made worse as logs of users are, for `identification_guards`.

A mutation is what happens to one log of a run (a rest, a gap), or what a user states wrongly of all of them (gears,
units, columns).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.excitation_runs import NOISE, FourierMotion, measured, torque_along
from benchmarks.guard_logs import JointLog
from benchmarks.random_arms import FrictionLaw, SyntheticArm, random_arm
from rx90_common.base.arrays import Array

RATE = 100.0
RUNS = 2
Mutation = Callable[[JointLog, np.random.Generator], JointLog]


def plain_arm(seed: int, joints: int) -> SyntheticArm:
    """Return a random arm without springs or coupled wrist, with Coulomb and viscous friction."""
    arm = random_arm(seed, joints, coupled=False, stribeck=False)
    laws = tuple(FrictionLaw((law.coulomb, law.coulomb), law.c2) for law in arm.friction)
    return replace(arm, friction=laws, spring=np.zeros(joints))


def excitation_log(
    arm: SyntheticArm, seed: int, moving: Array | None = None, period: float = 12.0
) -> JointLog:
    """Return a run; of the joints, shape (n,), only those that are `moving` move."""
    motion = FourierMotion.random(arm, seed, period=period, periods=1)
    if moving is not None:
        motion = replace(motion, cosine=motion.cosine * moving, sine=motion.sine * moving)
    return JointLog.of(measured(arm, motion, RATE, seed, NOISE), arm)


def sweep_logs(arm: SyntheticArm, seed: int) -> list[JointLog]:
    """Return a log of each joint: eight speeds in both directions at two poses, the other joints at rest."""
    rng = np.random.default_rng((seed, 70))
    n = len(arm.links)
    logs = []
    for joint in range(n):
        times, positions, velocities = [], [], []
        begin = 1.0
        for pose in rng.uniform(-1.0, 1.0, (2, n)):
            for speed in np.geomspace(0.03, 1.5, 8):
                for direction in (speed, -speed):
                    count = int(RATE * (0.2 + min(2.0, 0.8 / speed)))
                    ramp = np.clip(np.arange(count) / 10.0, 0.0, 1.0) * np.clip(
                        np.arange(count)[::-1] / 10.0, 0.0, 1.0
                    )
                    velocity = np.outer(ramp * direction, np.eye(n)[joint])
                    position = pose + np.cumsum(velocity, axis=0) / RATE - velocity[:1]
                    times.append(begin + np.arange(count) / RATE)
                    positions.append(position)
                    velocities.append(velocity)
                    begin += count / RATE
        time, position, velocity = (
            np.concatenate(parts) for parts in (times, positions, velocities)
        )
        torque = torque_along(arm, time, (position, velocity, np.zeros_like(position)))
        torque += 0.01 * arm.torque * rng.normal(size=torque.shape)
        logs.append(JointLog(arm.names, time, position, velocity, torque))
    return logs


def _joint(log: JointLog, rng: np.random.Generator) -> int:
    return int(rng.integers(len(log.names)))


def _changed(values: Array, joint: int, change: Callable[[Array], Array]) -> Array:
    found = values.copy()
    found[:, joint] = change(found[:, joint])
    return found


def rest(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Hold the whole arm for one to twenty seconds, at the torque of that instant."""
    start = int(rng.uniform(0.1, 0.9) * len(log.time))
    held = int(rng.uniform(1.0, 20.0) * RATE)
    rows = np.concatenate([np.arange(start), np.full(held, start), np.arange(start, len(log.time))])
    longer = log.part(rows)
    longer.velocity[start : start + held] = 0.0
    return replace(longer, time=log.time[0] + np.arange(len(rows)) / RATE)


def repeats(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Hold every position and velocity for some samples, as a slow bus does."""
    size = int(rng.integers(2, 12))
    rows = np.arange(len(log.time)) // size * size
    return replace(log, position=log.position[rows], velocity=log.velocity[rows])


def doubled_rows(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Write every third row twice, with the same stamp."""
    return log.part(
        np.sort(
            np.append(
                np.arange(len(log.time)), np.arange(0, len(log.time), int(rng.integers(2, 5)))
            )
        )
    )


def gaps(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Leave out 3 to 30 stretches of 2 to 80 samples."""
    kept = np.ones(len(log.time), dtype=np.bool_)
    for start in rng.integers(0, len(kept), int(rng.integers(3, 30))).tolist():
        kept[start : start + int(rng.integers(2, 80))] = False
    return log.part(kept)


def constant(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let one column of a joint, or of all, keep its first value."""
    name = str(rng.choice(["position", "velocity", "torque"]))
    values = getattr(log, name).copy()
    chosen = slice(None) if rng.random() < 0.3 else _joint(log, rng)
    values[:, chosen] = values[0, chosen]
    return replace(log, **{name: values})


def few_rows(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Keep one to forty rows."""
    return log.part(slice(0, int(rng.choice([1, 2, 3, 5, 10, 40]))))


def jump(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let a position jump by a turn at an instant."""
    instant = int(rng.integers(1, len(log.time)))

    def jumping(values: Array) -> Array:
        return values + 2.0 * np.pi * float(rng.choice([-1.0, 1.0])) * (
            np.arange(len(values)) >= instant
        )

    return replace(log, position=_changed(log.position, _joint(log, rng), jumping))


def holes(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let some cells be NaN."""
    torque = log.torque.copy()
    torque[rng.integers(0, len(torque), 5), _joint(log, rng)] = np.nan
    return replace(log, torque=torque)


def shocks(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let torques be a hundred times too large at some samples."""
    torque = log.torque.copy()
    torque[rng.integers(0, len(torque), 6), _joint(log, rng)] *= 100.0
    return replace(log, torque=torque)


def swapped(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Exchange the torques, or the positions, of two joints."""
    first, second = rng.choice(len(log.names), 2, replace=False).tolist()
    order = np.arange(len(log.names))
    order[[first, second]] = second, first
    if rng.random() < 0.5:
        return replace(log, torque=log.torque[:, order])
    return replace(log, position=log.position[:, order], velocity=log.velocity[:, order])


def scaled(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let torques be in mNm or kNm, or those of one joint larger by a half."""
    if rng.random() < 0.5:
        return replace(log, torque=log.torque * float(rng.choice([1e3, 1e-3])))
    return replace(log, torque=_changed(log.torque, _joint(log, rng), lambda values: 1.5 * values))


def milliseconds(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let times be in ms, or in us."""
    return replace(log, time=log.time * float(rng.choice([1e3, 1e6])))


def degrees(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let velocities, or positions, be in degrees."""
    if rng.random() < 0.5:
        return replace(log, velocity=np.degrees(log.velocity))
    return replace(log, position=np.degrees(log.position))


def delay(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let torques come 30 to 120 ms too late."""
    samples = int(rng.uniform(0.03, 0.12) * RATE)
    return replace(log.part(slice(samples, None)), torque=log.torque[: len(log.torque) - samples])


def gears(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Give the motors' torques beside the joints' angles."""
    return replace(log, torque=log.torque / rng.uniform(30.0, 200.0, len(log.names)))


def negated(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Turn the sign of the torque, or of the position, of a joint."""
    joint = _joint(log, rng)
    if rng.random() < 0.5:
        return replace(log, torque=_changed(log.torque, joint, np.negative))
    position, velocity = (
        _changed(values, joint, np.negative) for values in (log.position, log.velocity)
    )
    return replace(log, position=position, velocity=velocity)


def turned(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let the zero of the second joint be a quarter turn off; that of the first and the last may change no torque."""
    quarter = float(rng.choice([-0.5, 0.5])) * np.pi
    return replace(log, position=_changed(log.position, 1, lambda values: values + quarter))


def noise_alone(log: JointLog, rng: np.random.Generator) -> JointLog:
    """Let the torque of a joint be noise."""
    size = float(np.std(log.torque)) * 0.02
    return replace(
        log,
        torque=_changed(
            log.torque, _joint(log, rng), lambda values: size * rng.normal(size=len(values))
        ),
    )


OF_A_RUN: Sequence[Mutation] = (
    rest,
    repeats,
    doubled_rows,
    gaps,
    constant,
    few_rows,
    jump,
    holes,
    shocks,
    noise_alone,
)
"""Happen to each log by itself, and not to the one that is predicted."""
OF_THE_USER: Sequence[Mutation] = (
    swapped,
    scaled,
    milliseconds,
    degrees,
    delay,
    gears,
    negated,
    turned,
)
"""Are the same in all logs, the one that is predicted among them."""
