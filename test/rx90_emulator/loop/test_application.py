"""Values set in a setup and a task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pinocchio_chain import pinocchio_chain

from rx90_common.base.errors import ConfigError, LineError, Rx90Error
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.parameters import Catalogue, Leaf, Value, apply
from rx90_emulator.loop.setup import Setup


def leaves(catalogue: Catalogue, values: dict[str, Value]) -> dict[Leaf, Value]:
    """Return the leaves of paths, each with its value."""
    return {t: value for path, value in values.items() for p in catalogue.places(path) for t in p.leaves}


def assert_same_numbers(setup: Setup, other: Setup) -> None:
    """Check that two setups give the same plant and the same law, to the last bit."""
    assert setup.plant().constants.tobytes() == other.plant().constants.tobytes()
    assert setup.cs7b().law.tobytes() == other.cs7b().law.tobytes()


@pytest.mark.parametrize(
    ("path", "value", "role", "keys"),
    [
        ("friction.joint_2.c0", 1.2e5, "friction", ("elements", "joint_2", "c0")),
        ("friction.joint_5_6.tau_s", 2.2, "friction", ("elements", "joint_5_6", "tau_s")),
        ("drives.rotor_inertia[1]", 3.9, "drives", ("transmission", "rotor_inertia", 1)),
        ("drives.velocity_bandwidth", 350.0, "drives", ("encoder", "velocity_bandwidth")),
        ("controller.kp[0]", 65.0, "controller", ("servo", "kp", 0)),
        ("controller.coulomb_velocity", 0.004, "controller", ("feed_forward", "coulomb_velocity")),
        ("controller.feed_forward.coulomb", False, "controller", ("feed_forward", "coulomb")),
    ],
)
def test_a_path_does_what_an_edited_file_does(
    shipped: Setup,
    task: LineTask,
    catalogue: Catalogue,
    shipped_files: RobotFiles,
    edited_yaml: Callable[..., Path],
    path: str,
    value: Value,
    role: str,
    keys: tuple[str | int, ...],
) -> None:
    """Setting a value by its path gives the plant and the law that the edited file gives, bit for bit."""
    edited = edited_yaml(getattr(shipped_files, role), keys, value)
    by_file = Setup.load(replace(shipped_files, **{role: edited}))
    by_path, same_task = apply(shipped, task, leaves(catalogue, {path: value}))
    assert_same_numbers(by_path, by_file)
    assert same_task == task


def test_task_values(shipped: Setup, task: LineTask, catalogue: Catalogue) -> None:
    """Speed and coordinates of the line change alone, the setup not at all."""
    setup, changed = apply(shipped, task, leaves(catalogue, {"task.speed": 0.05, "task.end[1]": -0.28}))
    assert setup is shipped
    assert changed == replace(task, speed=0.05, end=(task.end[0], -0.28, task.end[2]))


def test_link_values_reach_chain_and_model(shipped: Setup, task: LineTask, catalogue: Catalogue) -> None:
    """A changed link is the same body in the compiled chain and in Pinocchio's model, the others untouched."""
    values = {"arm.link_3.mass": 20.0, "arm.link_3.com[2]": 0.15, "arm.link_5.inertia[0]": 0.0028}
    setup, _ = apply(shipped, task, leaves(catalogue, values))
    again = pinocchio_chain(setup.robot.model, setup.robot.tcp_frame)
    for name in ("mass", "com", "inertia"):
        np.testing.assert_allclose(getattr(setup.robot.chain, name), getattr(again, name), rtol=0, atol=1e-12)
    changed = setup.robot.chain.mass != shipped.robot.chain.mass
    assert changed.tolist() == [False, False, True, False, False, False]
    assert (setup.robot.chain.com != shipped.robot.chain.com).sum() == 1
    assert shipped.robot.model.inertias[3].mass == shipped.robot.chain.mass[2]


@pytest.mark.parametrize(
    ("path", "value", "kind", "said"),
    [
        ("friction.joint_1.omega_s", 0.0, ConfigError, "friction.joint_1: omega_s is 0.0"),
        ("drives.gear[*]", 0.0, ConfigError, r"drives: gear\[0\] is"),
        ("controller.kv[2]", -1.0, ConfigError, r"controller: kv\[2\] is"),
        ("arm.link_2.mass", 0.0, ConfigError, "arm.link_2.mass is 0 kg"),
        ("arm.link_2.inertia[0]", 50.0, ConfigError, "arm.link_2.inertia"),
        ("task.speed", -0.1, LineError, "speed is -0.1 m/s"),
    ],
)
def test_values_out_of_range_are_refused(
    shipped: Setup,
    task: LineTask,
    catalogue: Catalogue,
    path: str,
    value: float,
    kind: type[Rx90Error],
    said: str,
) -> None:
    """A value that no robot can have is refused with its place and what is accepted."""
    with pytest.raises(kind, match=said):
        apply(shipped, task, leaves(catalogue, {path: value}))
