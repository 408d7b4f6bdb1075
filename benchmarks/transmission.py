"""Elastic gears: frequencies, the rigid limit, convergence, cost, and what the reference task feels of them.

    python -m benchmarks.transmission [--plot FILE]

The stiffnesses are an assumed example: those of the RX90B's gears are not published.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy import linalg

from benchmarks.hybrid_reference import Work
from benchmarks.report import (
    PLOT,
    WIDTH,
    arguments,
    in_turns,
    plain_decades,
    print_table,
    ratios,
    timed,
)
from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.description.drives import Elasticity
from rx90_common.report.picture import picture
from rx90_common.report.style import COLOURS, INK
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.setup import Setup

EXAMPLE = np.array([1.5e6, 1.5e6, 5e5, 1e5, 6e4, 2e4])
"""Stiffnesses of the example, Nm/rad."""
DAMPED = 2e-4
"""Damping over stiffness, s."""
POSE = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
FACTORS = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
SUBSTEPS = np.array([1, 2, 4, 8])
FINEST = 64
ROUNDS = 15


def elastic(setup: Setup, factor: float = 1.0, backlash: float = 0.0) -> Setup:
    """Return a setup with the example's stiffnesses, times a factor, and play, rad."""
    gears = Elasticity(
        stiffness=EXAMPLE * factor, damping=DAMPED * EXAMPLE * factor, backlash=np.full(6, backlash)
    )
    return replace(setup, drives=setup.drives.replaced(elasticity=gears))


def frequencies(setup: Setup) -> tuple[Array, Array]:
    """Return the analytic eigenfrequencies at POSE with held and with free motors, Hz, six each."""
    upper = np.triu(pin.crba(setup.robot.model, setup.robot.model.createData(), POSE))
    mass = upper + np.triu(upper, 1).T
    stiffness, wrist = np.diag(EXAMPLE), RX_WRIST.turns
    coupled = stiffness @ wrist
    held = linalg.eigh(wrist.T @ coupled, mass, eigvals_only=True)
    both = np.block([[wrist.T @ coupled, -coupled.T], [-coupled, stiffness]])
    free = linalg.eigh(
        both, linalg.block_diag(mass, np.diag(setup.drives.rotor_inertia)), eigvals_only=True
    )[6:]
    return np.sqrt(held) / (2.0 * np.pi), np.sqrt(free) / (2.0 * np.pi)


def way(setup: Setup, substeps: int = 1) -> Array:
    """Return the joints' way under random torques, rad, shape (200, 6)."""
    plant, rng, rows = setup.plant(substeps), np.random.default_rng(5), []
    plant.reset(POSE)
    for k in range(200):
        if k % 50 == 0:
            motor = rng.uniform(-0.4, 0.4, 6) * setup.drives.peak_torque
        plant.step(motor)
        rows.append(plant.joint_states()[0].copy())
    return np.array(rows)


def cost(work: Work) -> dict[str, float]:
    """Return the time of the reference line over that of rigid gears, by case, taken in turns."""
    cases = {
        "rigid": work.setup,
        "elastic": elastic(work.setup),
        "elastic with play": elastic(work.setup, 1.0, 1e-4),
    }
    runs = {
        name: timed(lambda one=one: work.run(one))  # type: ignore[misc]
        for name, one in cases.items()
    }
    return ratios(in_turns(runs, ROUNDS), "rigid")


def stopping(setup: Setup) -> tuple[Array, Array, Array]:
    """Return times, s, and speeds, rad/s, of link 1 and its motor after a quick move has stopped."""
    names, zero, end = setup.robot.joint_names, np.zeros(6), np.zeros(6)
    end[0] = 0.3
    move = TrajectoryPoints.create(
        names, names, [0.0, 0.4], [zero, end], [zero, zero], [zero, zero]
    )
    run = simulate(setup, move, zero, 0.9, record_fast=True)
    assert run.fast is not None
    links = run.slow.joint_states[:, 1, 0]
    motors = run.fast.motor_states[:: setup.rates.ratio, 1, 0] / setup.drives.gear[0]
    shown = (run.times >= 0.4) & (run.times < 0.7)
    return run.times[shown], links[shown], motors[shown]


def draw(setup: Setup, miss: Array, file: Path) -> None:
    """Draw the rigid limit and the ringing of a link as a picture."""
    factors = np.array(FACTORS)
    times, soft, motor = stopping(elastic(setup, 0.1))
    _, rigid, _ = stopping(setup)
    with picture(file) as figure:
        figure.set_size_inches(WIDTH, 6.4)
        limit, ringing = figure.subplots(2)
        limit.loglog(factors, miss * 1e6, ".-", color=COLOURS[0], label="elastic less rigid")
        limit.loglog(
            factors, 2.0 * miss[-1] * 1e6 * factors[-1] / factors, ":", color=INK, label="order 1"
        )
        limit.set(xlabel="stiffness, times the example's", ylabel="largest difference, µrad")
        ringing.plot(times, soft * 1e3, color=COLOURS[1], label="link, a tenth of the stiffness")
        ringing.plot(times, motor * 1e3, color=COLOURS[0], label="its motor")
        ringing.plot(times, rigid * 1e3, "--", color=INK, label="rigid gears")
        ringing.set(
            xlabel="time, s, after a quick move that ends at 0.4 s",
            ylabel="speed of joint 1, mrad/s",
        )
        plain_decades(limit)
        for panel in (limit, ringing):
            panel.legend()


def main() -> int:
    """Compute, print the tables and draw the plot if it is asked for."""
    options = arguments(__doc__, PLOT)
    work = Work.load()
    setup, task = work.setup, load_task()
    held, free = frequencies(setup)
    print_table(
        ("eigenfrequencies, Hz", *(str(k) for k in range(1, 7))),
        [
            ("motors held", *(f"{f:.1f}" for f in held)),
            ("motors free", *(f"{f:.1f}" for f in free)),
        ],
    )
    print()
    rigid = way(setup)
    miss = np.array([np.abs(way(elastic(setup, factor)) - rigid).max() for factor in FACTORS])
    orders = ["", *(f"{o:.2f}" for o in np.log10(miss[:-1] / miss[1:]))]
    print_table(
        ("stiffness, times the example's", "from rigid, µrad", "order"),
        [(f"{f:g}", f"{m * 1e6:.3g}", o) for f, m, o in zip(FACTORS, miss, orders, strict=True)],
    )
    print()
    best = way(elastic(setup, 0.1), FINEST)
    errors = np.array([np.abs(way(elastic(setup, 0.1), int(n)) - best).max() for n in SUBSTEPS])
    orders = ["", *(f"{o:.2f}" for o in np.log2(errors[:-1] / errors[1:]))]
    print_table(
        ("plant steps in a tick, a tenth of the stiffness", f"from {FINEST} steps, µrad", "order"),
        [(str(n), f"{e * 1e6:.3g}", o) for n, e, o in zip(SUBSTEPS, errors, orders, strict=True)],
    )
    print()
    paths = [run_line(elastic(setup, factor), task).path_accuracy.worst for factor in FACTORS[:5]]
    print_table(
        ("stiffness, times the example's", "worst path error of the reference task, mm"),
        [(f"{f:g}", f"{p * 1e3:.3f}") for f, p in zip(FACTORS, paths, strict=False)]
        + [("rigid", f"{run_line(setup, task).path_accuracy.worst * 1e3:.3f}")],
    )
    print()
    print_table(
        ("a tick of the closed loop", "x rigid"),
        [(name, f"{r:.2f}") for name, r in cost(work).items()],
    )
    if options.plot is not None:
        draw(setup, miss, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
