"""Dotted paths to the values of setup and task."""

from __future__ import annotations

from dataclasses import fields

import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.description.current_sensor import CurrentSensor
from rx90_common.description.drives import DriveParameters
from rx90_common.description.elasticity import Elasticity
from rx90_common.description.winding import Windings
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.table import PARTS
from rx90_controller.law.parameters import CS7BParameters, FeedForward
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.catalogue import Catalogue, Leaf


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
        (Leaf(("controller", "kp"), i),) for i in range(6)
    ]
    assert len(catalogue.places("arm.*.com[*]")) == 18


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
