"""Speed of the closed loop on one core, beside MuJoCo, Pinocchio and the same tick as plain loops.

    python -m benchmarks.closed_loop

The task is the reference line at 4 kHz with everything on: coupling, spring, seven LuGre elements, quantised
encoders, saturation, loops at two rates. The peers get the same arm, which is checked, the same set-points and the
same law in plain Python; MuJoCo's bare loop in C gets no law at all. One tick of plant and law, with nothing recorded,
is also measured as plain loops (benchmarks.plain_loops), compiled by numba with the same options. Times are CPU times
of the one thread that works, and all take turns, so that other load on the machine affects all of them.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.hybrid_reference import Work
from benchmarks.mujoco_arm import mass_and_bias as mujoco_mass_and_bias
from benchmarks.mujoco_arm import mujoco_arm
from benchmarks.pinocchio_arm import PinocchioArm
from benchmarks.plain_loops import run_lanes, run_plain
from benchmarks.python_law import PythonDrives, PythonLaw
from benchmarks.report import merge, print_table
from rx90_common.dynamics.manipulator import mass_and_bias
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]

ROUNDS = 9
PYTHON_TICKS = 4000
C_TICKS = 40_000
LANES, PLAIN = "one tick, lanes", "one tick, plain loops"
MOVING = 1.0
"""From when on the peers run, s: the arm moves there."""


def check_same_arm(setup: Setup, samples: int = 50) -> None:
    """Compare the mass matrix and the bias torques of the three arms at random states.

    Raises:
        RuntimeError: if they differ by more than rounding.
    """
    plant = setup.plant()
    model = mujoco_arm(setup)
    data, pinocchio = mujoco.MjData(model), PinocchioArm(setup, np.zeros(6))
    rng = np.random.default_rng(1)
    for _ in range(samples):
        q = rng.uniform(setup.robot.lower, setup.robot.upper)
        v = rng.uniform(-1.0, 1.0, 6) * setup.robot.max_velocity
        ours = np.empty((6, 6)), np.empty(6)
        mass_and_bias(plant.constants[0]["arm"], plant.state[0]["body"], q, v, *ours)
        peers = {"MuJoCo": mujoco_mass_and_bias(model, data, q, v), "Pinocchio": pinocchio.mass_and_bias(q, v)}
        for name, theirs in peers.items():
            for what, a, b in zip(("mass matrix", "bias"), ours, theirs, strict=True):
                miss = np.abs(np.triu(a - b)).max()
                if not miss < 1e-9 * np.abs(a).max():
                    raise RuntimeError(f"the arm in {name} is another: its {what} is off by {miss:g}")


def run_ours(work: Work) -> float:
    """Run the whole task compiled; return s per tick."""
    began = time.process_time()
    simulate(work.setup, work.points, work.start, work.duration)
    return (time.process_time() - began) / (work.duration * work.setup.rates.base_hz)


class Ticks:
    """Plant and law over the whole line, with lanes or as plain loops, and nothing around them."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(0.0, round(work.duration * work.setup.rates.base_hz))

    def run(self, kernel: Callable[..., None]) -> tuple[float, Array]:
        """Run one of both kernels; return s per tick and the joint positions on position ticks, rad, shape (m, 6)."""
        plant, controller = self._work.setup.plant(), self._work.setup.cs7b()
        plant.reset(self._work.start)
        controller.reset(plant.motor_states()[0])
        ratio, q = self._work.setup.rates.ratio, np.empty((len(self._setpoints), 6))
        began = time.process_time()
        kernel(plant.constants, plant.state, controller.law, controller.state, self._setpoints, ratio, q)
        return (time.process_time() - began) / (len(q) * ratio), q

    def check(self, accepted: float = 5e-7) -> None:
        """Compare both paths; rounding may move the moment at which a position counts.

        Raises:
            RuntimeError: if they part by more than `accepted`, rad.
        """
        miss = np.abs(self.run(run_lanes)[1] - self.run(run_plain)[1]).max()
        if not miss < accepted:
            raise RuntimeError(f"the plain loops move another way: {miss:g} rad off; accepted: below {accepted:g}")


def run_with_python_law(
    work: Work, setpoints: Array, position: Callable[[], Sequence[float]], step: Callable[[list[float]], None]
) -> float:
    """Run a peer under the law in plain Python; return s per tick."""
    ratio = work.setup.rates.ratio
    rows = setpoints.tolist()
    drives, law = PythonDrives(work.setup, position()), PythonLaw(work.setup)
    began = time.process_time()
    for tick in range(len(rows) * ratio):
        if tick % ratio == 0:
            law.position_loop(rows[tick // ratio], drives.position)
        step(law.velocity_loop(drives.velocity))
        drives.sample(position())
    return (time.process_time() - began) / (len(rows) * ratio)


class MujocoPeers:
    """MuJoCo's arm, moving as the set-points do where they begin."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(MOVING, PYTHON_TICKS)
        self._model = mujoco_arm(work.setup)
        self._data = mujoco.MjData(self._model)

    def from_python(self) -> float:
        """Step it from Python under the law; return s per tick."""
        model, data = self._model, self._data
        self._reset()
        control = data.ctrl

        def step(torques: list[float]) -> None:
            control[:6] = torques
            mujoco.mj_step(model, data)

        seconds = run_with_python_law(self._work, self._setpoints, data.qpos.tolist, step)
        _check_tracking("MuJoCo", data.qpos, self._setpoints)
        return seconds

    def bare(self) -> float:
        """Run its own loop in C under constant torques; return s per tick."""
        self._reset()
        began = time.process_time()
        mujoco.mj_step(self._model, self._data, nstep=C_TICKS)
        return (time.process_time() - began) / C_TICKS

    def _reset(self) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = self._setpoints[0, 0], self._setpoints[0, 1]


class PinocchioPeer:
    """Pinocchio's arm, moving as the set-points do where they begin."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(MOVING, PYTHON_TICKS)

    def from_python(self) -> float:
        """Step it from Python under the law; return s per tick."""
        arm = PinocchioArm(self._work.setup, self._setpoints[0, 0])
        arm.v[:] = self._setpoints[0, 1]
        seconds = run_with_python_law(self._work, self._setpoints, arm.q.tolist, arm.step)
        _check_tracking("Pinocchio", arm.q, self._setpoints)
        return seconds


def _check_tracking(name: str, q: Array, setpoints: Array) -> None:
    miss = np.abs(q - setpoints[-1, 0]).max()
    if not miss < 2e-3:
        raise RuntimeError(f"{name} does not follow the line: {miss:g} rad off; accepted: below 0.002")


def measure(rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Return the times per tick of all rounds, s, by who ran."""
    work = Work.load()
    check_same_arm(work.setup)
    ticks = Ticks(work)
    ticks.check()
    peers, pinocchio = MujocoPeers(work), PinocchioPeer(work)
    runs = {
        "this project": lambda: run_ours(work),
        "MuJoCo from Python": peers.from_python,
        "MuJoCo, bare C loop": peers.bare,
        "Pinocchio from Python": pinocchio.from_python,
        LANES: lambda: ticks.run(run_lanes)[0],
        PLAIN: lambda: ticks.run(run_plain)[0],
    }
    for run in runs.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            times[name].append(run())
    return times


def ratios(times: dict[str, list[float]], base: str = "this project") -> dict[str, float]:
    """Return how many times longer than the base each takes, the median of the rounds' ratios."""
    ours = times[base]
    return {
        name: statistics.median(theirs / own for theirs, own in zip(series, ours, strict=True))
        for name, series in times.items()
    }


def main() -> int:
    """Measure, print the table and merge the figures."""
    times = measure()
    period = Setup.load().rates.period
    median = {name: statistics.median(series) for name, series in times.items()}
    ratio = ratios(times)
    print_table(
        ("closed loop at 4 kHz", "us per tick", "best", "x real time", "x this project"),
        [
            (
                name,
                f"{seconds * 1e6:.2f}",
                f"{min(times[name]) * 1e6:.2f}",
                f"{period / seconds:.0f}",
                f"{ratio[name]:.1f}",
            )
            for name, seconds in median.items()
        ],
    )
    merge(
        {
            "closed_loop_real_time_factor": period / median["this project"],
            "closed_loop_us_per_tick": median["this project"] * 1e6,
            "versus_mujoco_python": ratio["MuJoCo from Python"],
            "versus_mujoco_c": ratio["MuJoCo, bare C loop"],
            "versus_pinocchio_python": ratio["Pinocchio from Python"],
            "tick_lanes_us": median[LANES] * 1e6,
            "tick_plain_loops_us": median[PLAIN] * 1e6,
            "versus_plain_loops": ratios(times, LANES)[PLAIN],
        }
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
