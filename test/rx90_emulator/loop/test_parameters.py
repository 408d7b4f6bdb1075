"""Values of setup and task by dotted paths: what there is, and what setting one does."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import full_friction
import numpy as np
import pytest
from pinocchio_chain import pinocchio_chain

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import FileModel, Model, word_of
from rx90_common.description.drives import Cogging
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.element import PARTS as PART_NAMES
from rx90_common.friction.parts.bristles import ElastoPlastic
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_emulator.loop.parameters import Catalogue, Leaf, Value, apply, parameters, with_parameters

WAVES = RipplePart(motor_harmonic=(2.0, 4.0), motor_amplitude=(0.1, 0.2))
PARTS = {**full_friction.PARTS, "ripple": WAVES, "bristles": ElastoPlastic(break_away=0.7)}
COGGING = Cogging(harmonic=[2.0, 6.0], amplitude=(np.arange(12.0).reshape(2, 6) / 100.0).tolist())


@pytest.fixture
def parted(shipped: rx.Setup) -> rx.Setup:
    one, two, *others = shipped.friction.elements
    return replace(shipped, friction=FrictionSet(shipped.friction.names, (one, two.replaced(**PARTS), *others)))


def leaves(catalogue: Catalogue, values: dict[str, Value]) -> dict[Leaf, Value]:
    return {t: value for path, value in values.items() for p in catalogue.places(path) for t in p.leaves}


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
    shipped: rx.Setup,
    task: rx.LineTask,
    catalogue: Catalogue,
    shipped_files: rx.RobotFiles,
    edited_yaml: Callable[..., Path],
    path: str,
    value: Value,
    role: str,
    keys: tuple[str | int, ...],
) -> None:
    """Setting a value by its path gives the plant and the law that the edited file gives, bit for bit."""
    edited = edited_yaml(getattr(shipped_files, role), keys, value)
    by_file = rx.Setup.load(replace(shipped_files, **{role: edited}))
    by_path, same_task = apply(shipped, task, leaves(catalogue, {path: value}))
    assert by_path.plant().constants.tobytes() == by_file.plant().constants.tobytes()
    assert by_path.cs7b().law.tobytes() == by_file.cs7b().law.tobytes()
    assert same_task == task


def test_values_of_task_and_links(shipped: rx.Setup, task: rx.LineTask, catalogue: Catalogue) -> None:
    """Coordinates of the line change alone; a changed link is the same body in the chain and in Pinocchio's model."""
    setup, changed_task = apply(shipped, task, leaves(catalogue, {"task.speed": 0.05, "task.end[1]": -0.28}))
    assert setup is shipped
    assert changed_task == replace(task, speed=0.05, end=(task.end[0], -0.28, task.end[2]))
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
    ("path", "value", "said"),
    [
        ("friction.joint_2.tau_c", -1.0, "friction.joint_2: tau_c.positive is -1.0; accepted"),
        ("friction.joint_2.ripple.motor_amplitude[0]", 0.9, "motor_amplitude is '1.1'; accepted: amplitudes that"),
        ("controller.feed_forward.coulomb", 0.5, "'controller.feed_forward.coulomb': a value is 0.5; accepted: true"),
        ("drives.elasticity.backlash[1]", 1e-3, "drives: elasticity.backlash[1] is 0.001; accepted: 0"),
        ("arm.link_2.mass", 0.0, "arm.link_2.mass is 0 kg"),
        ("arm.link_2.inertia[0]", 50.0, "arm.link_2.inertia"),
        ("arm.seed", 0.5, "arm.seed is 0.5; accepted: a whole number from 0 to 9007199254740992"),
        ("friction.joint_9.c0", 1.0, "'joint_9' is unknown (did you mean joint_6?); accepted there: joint_1, joint_2"),
        ("friction.joint_1", 1.0, "is a group of values"),
        ("drives.gear[" + "9" * 5000 + "]", 1.0, "is not a path; accepted: such as friction.joint_2.c0"),
        ("drives.gear", 1.0, "6 numbers; accepted: up to drives.gear[5], or *"),
        ("friction.joint_1.*", 1.0, "different units"),
    ],
)
def test_wrong_paths_and_values_are_refused(parted: rx.Setup, path: str, value: float | str, said: str) -> None:
    """A path that names nothing or too much, and a value out of range, are one line with what is accepted."""
    with pytest.raises(ConfigError) as caught:
        with_parameters(parted, {path: value})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("prefix", "kind", "without"),
    [("friction.joint_5_6", FrictionElement, set(PART_NAMES)), ("task", rx.LineTask, {"branch", "start_posture"})],
)
def test_every_number_has_a_path(catalogue: Catalogue, prefix: str, kind: type, without: set[str]) -> None:
    """No parameter of friction, drives, controller and line can be forgotten in the table of paths."""
    names = kind.model_fields if issubclass(kind, Model) else [field.name for field in fields(kind)]
    for name in names:
        if name not in {*without, *FileModel.about_keys}:
            try:
                places = catalogue.places(f"{prefix}.{name}")
            except ConfigError:
                places = catalogue.places(f"{prefix}.{name}[*]")
            assert name in {key for place in places for key in place.leaves[0].key}


def test_star_and_index_expand(catalogue: Catalogue) -> None:
    """A star stands for all elements or motors, an index for one, tau_c for both signs; values are the files'."""
    assert [place.path for place in catalogue.places("friction.*.tau_c")] == [
        *(f"friction.joint_{i}.tau_c" for i in range(1, 7)),
        "friction.joint_5_6.tau_c",
    ]
    (both,) = catalogue.places("friction.joint_2.tau_c")
    assert [leaf.key[-2:] for leaf in both.leaves] == [("tau_c", "positive"), ("tau_c", "negative")]
    assert catalogue.places("friction.joint_2.tau_c_negative")[0].leaves == both.leaves[1:]
    assert [p.leaves for p in catalogue.places("controller.kp[*]")] == [
        (Leaf(("controller", "servo", "kp"), (i,)),) for i in range(6)
    ]
    assert len(catalogue.places("arm.*.com[*]")) == 18
    paths = ("friction.joint_3.c0", "drives.rotor_inertia[1]", "controller.feed_forward.coulomb", "task.end[2]")
    assert [catalogue.value(catalogue.places(path)[0].leaves[0]) for path in paths] == [7.0e4, 3.5, True, 0.1955]


def test_cogging_has_paths_where_motors_cog(shipped: rx.Setup) -> None:
    """A wave's amplitude for one motor, or all, is set as the file has it."""
    setup = replace(shipped, drives=shipped.drives.replaced(cogging=COGGING))
    listed = {path: value for path, value in parameters(setup).items() if path.startswith("drives.cogging")}
    assert len(listed) == 2 + 12 + 12
    assert listed["drives.cogging.amplitude[1][3]"] == (0.09, "Nm")
    assert listed["drives.cogging.harmonic[1]"] == (6.0, "1")
    changed = {"drives.cogging.amplitude[0][*]": 0.5, "drives.cogging.amplitude[1][3]": 0.25}
    want = np.array(COGGING.amplitude)
    want[0], want[1, 3] = 0.5, 0.25
    found = with_parameters(setup, changed | {"drives.cogging.phase[*][5]": 1.0}).drives.cogging
    assert np.array_equal(found.amplitude, want)
    assert np.array_equal(found.phase, [[0.0] * 5 + [1.0]] * 2)


def test_every_value_of_a_part_has_a_path(parted: rx.Setup) -> None:
    """Each field of each part of an element can be set by its path, each number of a list by its index."""
    listed = rx.parameters(parted)
    for name, part in PARTS.items():
        for key, number in part.numbers().items():
            path = f"friction.joint_2.{name}.{key}"
            assert listed[path] == (number, word_of(type(part), key.partition("[")[0], "unit"))
            element = rx.with_parameters(parted, {path: 0.9 * number}).friction.elements[1]
            assert element.parts[name].numbers()[key] == 0.9 * number
    paths = [place.path for place in Catalogue(parted).places("friction.*.load.driving")]
    assert paths == ["friction.joint_2.load.driving"]


def test_the_seed_is_the_plants(parted: rx.Setup) -> None:
    """The seed of a setup is a parameter, a whole number that the plant takes."""
    setup = rx.with_parameters(parted, {"arm.seed": 12})
    assert setup.seed == 12
    assert setup.plant().constants["parts"]["scatter"]["seed"][0] == 12
    for seed in (-1, "a", 0.5, True, 2**53 + 1):
        with pytest.raises(ConfigError, match=f"seed is {seed!r}; accepted: a whole number from 0"):
            replace(parted, seed=seed)


def test_numpy_s_scalars_are_numbers(parted: rx.Setup) -> None:
    """A scalar of NumPy's, of whatever type, counts as Python's number of its value, and stays a plain one."""
    path = "friction.joint_2.load.driving"
    for value in (np.float32(0.25), np.float64(0.25), np.int64(0), np.float16(0.25)):
        driving = rx.with_parameters(parted, {path: value}).friction["joint_2"].load.driving
        assert (type(driving), driving) == (float, float(value))
        assert type(LoadPart(driving=value, driven=value).driven) is float
    off = rx.with_parameters(parted, {"controller.feed_forward.coulomb": np.bool_(False)})
    assert off.controller.feed_forward.coulomb is False


def test_friction_must_not_follow_the_load_faster_than_the_step(parted: rx.Setup) -> None:
    """A relax_time below the plant's step is refused by its path, and taken with shorter steps."""
    quick = rx.with_parameters(parted, {"friction.joint_2.load.relax_time": 1e-4})
    with pytest.raises(ConfigError, match=r"joint_2\.load\.relax_time is 0.0001 s; accepted: at least the pl"):
        quick.plant()
    quick.plant(substeps=4)
