"""A small sweep over a short line."""

from pathlib import Path

import pytest

from rx90_emulator.sweep.plan import SweepPlan
from rx90_emulator.sweep.sweep import RunOutcome, Sweep


@pytest.fixture(scope="session")
def plan(task_file: Path) -> SweepPlan:
    """Return 40 runs, four of which fail: a grid of two switches by ten draws, twenty draws of one robot."""
    stiffness = {"factor": {"loguniform": [0.5, 2.0]}}
    inertia = {"paths": ["drives.rotor_inertia[*]"], "factor": {"uniform": [0.8, 1.2]}, "each": True}
    switch = {"paths": ["controller.feed_forward.viscous"], "value": [True, False]}
    scatter = {"grid": {"viscous": switch}, "random": {"friction.*.c0": stiffness, "rotors": inertia}, "draws": 10}
    masses = {"value": [8.0, 12.0, -1.0, 16.0, 20.0]}
    payload = {
        "grid": {"arm.link_3.mass": masses, "viscous": switch},
        "random": {"friction.*.c0": stiffness},
        "draws": 2,
    }
    content = {"seed": 7, "base": {"task": str(task_file)}, "blocks": {"scatter": scatter, "payload": payload}}
    return SweepPlan.model_validate(content)


@pytest.fixture(scope="session")
def sweep(plan: SweepPlan) -> Sweep:
    ready = Sweep(plan)
    ready.warm_up()
    return ready


@pytest.fixture(scope="session")
def outcomes(sweep: Sweep) -> list[RunOutcome]:
    return [sweep.run(index) for index in range(len(sweep))]
