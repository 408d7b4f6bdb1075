"""A small sweep over a short line."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.sweep.plan import Block, LogUniform, SweepBase, SweepPlan, SweptParameter, Uniform, Values
from rx90_emulator.sweep.sweep import RunOutcome, Sweep


@pytest.fixture(scope="session")
def plan(task_file: Path) -> SweepPlan:
    """Return 40 runs, four of which fail: a grid of two switches by ten draws, twenty draws of one robot."""
    stiffness = SweptParameter("friction.*.c0", factor=True, space=LogUniform(0.5, 2.0))
    inertia = SweptParameter(
        "rotors", paths=("drives.rotor_inertia[*]",), factor=True, space=Uniform(0.8, 1.2), each=True
    )
    switch = SweptParameter("viscous", paths=("controller.feed_forward.viscous",), space=Values((True, False)))
    masses = SweptParameter("arm.link_3.mass", space=Values((8.0, 12.0, -1.0, 16.0, 20.0)))
    return SweepPlan(
        (
            Block("scatter", (switch,), (stiffness, inertia), draws=10),
            Block("payload", (masses, switch), (stiffness,), draws=2),
        ),
        seed=7,
        base=SweepBase(RobotFiles(task=task_file)),
    )


@pytest.fixture(scope="session")
def sweep(plan: SweepPlan) -> Sweep:
    """Return the small sweep, its kernels compiled."""
    ready = Sweep(plan)
    ready.warm_up()
    return ready


@pytest.fixture(scope="session")
def outcomes(sweep: Sweep) -> list[RunOutcome]:
    """Return what comes of its runs, computed one after the other in this process."""
    return [sweep.run(index) for index in range(len(sweep))]


@pytest.fixture(autouse=True)
def _no_plots(undrawn: None) -> None:
    """Leave plots out where a test does not look at them; those of shared runs are drawn."""
