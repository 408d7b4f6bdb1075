"""Dotted paths to the values of setup and task."""

from __future__ import annotations

import re
from dataclasses import fields, replace

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import Cogging, CurrentSensor, DriveParameters, Elasticity, Windings
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import PARTS
from rx90_controller.law.parameters import CS7BParameters, FeedForward
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.parameters import Catalogue, Leaf, parameters, with_parameters
from rx90_emulator.loop.setup import Setup


@pytest.mark.parametrize(
    ("prefix", "kind", "without"),
    [
        ("friction.joint_5_6", FrictionElement, set(PARTS)),
        ("drives", DriveParameters, {"elasticity", "cogging", "winding", "current_sensor"}),
        ("drives.winding", Windings, set()),
        ("drives.current_sensor", CurrentSensor, set()),
        ("drives.elasticity", Elasticity, {"friction_side"}),
        ("controller", CS7BParameters, {"feed_forward", "model"}),
        ("controller.feed_forward", FeedForward, set()),
        ("task", LineTask, {"branch"}),
    ],
)
def test_every_number_has_a_path(catalogue: Catalogue, prefix: str, kind: type, without: set[str]) -> None:
    """No parameter of friction, drives, controller and line can be forgotten in the table of paths."""
    for field in fields(kind):
        if field.name in without:
            continue
        try:
            places = catalogue.places(f"{prefix}.{field.name}")
        except ConfigError:
            places = catalogue.places(f"{prefix}.{field.name}[*]")
        assert {place.leaves[0].key[-1] for place in places} == {field.name}


def test_star_and_index_expand(catalogue: Catalogue) -> None:
    """A star stands for all seven elements or all six motors, an index for one, tau_c for both signs."""
    assert [place.path for place in catalogue.places("friction.*.tau_c")] == [
        *(f"friction.joint_{i}.tau_c" for i in range(1, 7)),
        "friction.joint_5_6.tau_c",
    ]
    (both,) = catalogue.places("friction.joint_2.tau_c")
    assert [leaf.key[-1] for leaf in both.leaves] == ["tau_c_positive", "tau_c_negative"]
    assert [p.leaves for p in catalogue.places("controller.kp[*]")] == [
        (Leaf(("controller", "kp"), (i,)),) for i in range(6)
    ]
    assert len(catalogue.places("arm.*.com[*]")) == 18


COGGING = Cogging(np.array([2.0, 6.0]), np.arange(12.0).reshape(2, 6) / 100.0, np.zeros((2, 6)))


def test_cogging_has_paths_where_motors_cog(shipped: Setup) -> None:
    """A wave's amplitude for one motor, or all, is set as the file has it; without cogging, and beyond it, refused."""
    setup = replace(shipped, drives=replace(shipped.drives, cogging=COGGING))
    listed = {path: value for path, value in parameters(setup).items() if path.startswith("drives.cogging")}
    assert len(listed) == 2 + 12 + 12
    assert listed["drives.cogging.amplitude[1][3]"] == (0.09, "Nm")
    assert listed["drives.cogging.harmonic[1]"] == (6.0, "1")
    changed = {"drives.cogging.amplitude[0][*]": 0.5, "drives.cogging.amplitude[1][3]": 0.25}
    want = COGGING.amplitude.copy()
    want[0], want[1, 3] = 0.5, 0.25
    found = with_parameters(setup, changed | {"drives.cogging.phase[*][5]": 1.0}).drives.cogging
    assert found.amplitude.tolist() == want.tolist()
    assert found.phase.tolist() == [[0.0] * 5 + [1.0]] * 2
    for path, said in (
        ("drives.cogging.amplitude[1]", "is 2 by 6 numbers; accepted: drives.cogging.amplitude[0][0] to drives.cogging."
         "amplitude[1][5], or drives.cogging.amplitude[*][*]"),
        ("drives.cogging.amplitude[2][0]", "is 2 by 6 numbers"),
        ("drives.cogging.harmonic[0][0]", "is 2 numbers; accepted: drives.cogging.harmonic[0] to"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=re.escape(said)):
            with_parameters(setup, {path: 1.0})
    with pytest.raises(ConfigError, match="the motors have no cogging; accepted: with a drives file that has it"):
        with_parameters(shipped, {"drives.cogging.amplitude[0][0]": 1.0})


def test_values_are_those_of_the_files(catalogue: Catalogue) -> None:
    """What a factor multiplies is the number in the shipped file."""
    found = [
        catalogue.value(catalogue.places(path)[0].leaves[0])
        for path in (
            "friction.joint_3.c0",
            "drives.rotor_inertia[1]",
            "controller.feed_forward.coulomb",
            "task.end[2]",
        )
    ]
    assert found == [7.0e4, 3.5, True, 0.1955]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("friction.joint_9.c0", "'joint_9' is unknown; accepted there: joint_1, joint_2"),
        ("friction.joint_1.c9", "'c9' is unknown; accepted there: alpha, c0, c1, c2"),
        ("fricton.joint_1.c0", "accepted there: arm, controller, drives, friction, task"),
        ("friction.joint_1", "is a group of values"),
        ("drives.gear[0].x", "is not a path"),
        ("task.speed.x", "goes on after a value; accepted: task.speed"),
        ("drives.gear", "6 numbers; accepted: drives.gear[0] to drives.gear[5], or drives.gear[*]"),
        ("drives.gear[6]", "6 numbers"),
        ("task.speed[0]", "is one value; accepted: task.speed, without an index"),
        ("friction.joint_1.*", "different units"),
        ("", "is not a path"),
    ],
)
def test_wrong_paths_are_refused(catalogue: Catalogue, path: str, said: str) -> None:
    """A path that names nothing, a group, or too much is refused in one line with what is accepted."""
    with pytest.raises(ConfigError) as error:
        catalogue.places(path)
    assert path in str(error.value)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
