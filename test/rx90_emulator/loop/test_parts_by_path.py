"""Parts of friction elements, and the seed, by dotted paths."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_emulator.loop.parameters import Catalogue
from rx90_emulator.loop.setup import Setup

PARTS = {
    "load": LoadPart(0.05, 0.08),
    "ripple": RipplePart((1.0,), (0.1,), (0.0,), (2.0, 4.0), (0.1, 0.05), (0.3, 0.0)),
    "scatter": ScatterPart(0.02, 5.0),
    "bristles": ElastoPlastic(0.7),
}


@pytest.fixture
def parted(shipped: Setup) -> Setup:
    """Return the shipped setup, whose second element has all parts."""
    one, two, *others = shipped.friction.elements
    return replace(shipped, friction=FrictionSet(shipped.friction.names, (one, replace(two, **PARTS), *others)))


def test_every_value_of_a_part_has_a_path(parted: Setup) -> None:
    """Each field of each part of an element can be set by its path, each number of a list by its index."""
    listed = rx.parameters(parted)
    for name, part in PARTS.items():
        for field in fields(part):
            value = getattr(part, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            for i, number in enumerate(numbers):
                path = f"friction.joint_2.{name}.{field.name}{f'[{i}]' if isinstance(value, tuple) else ''}"
                assert listed[path] == (number, part.units()[field.name])
                element = rx.with_parameters(parted, {path: 0.9 * number}).friction.elements[1]
                changed = getattr(getattr(element, name), field.name)
                assert (changed[i] if isinstance(value, tuple) else changed) == 0.9 * number
    paths = [place.path for place in Catalogue(parted).places("friction.*.load.driving")]
    assert paths == ["friction.joint_2.load.driving"]


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("friction.joint_2.load.driving", 2.0, "friction.joint_2: load: driving is 2.0; accepted: a number in [0"),
        ("friction.joint_2.ripple.motor_amplitude[0]", 0.9, "friction.joint_2: ripple: the amplitudes sum to 1.05"),
        ("friction.joint_2.tau_c", -1.0, "friction.joint_2: tau_c_positive is -1.0; accepted"),
        ("friction.joint_1.load.driving", 0.1, "joint_1 has no part load; accepted: with a friction file"),
        ("arm.seed", 0.5, "arm.seed is 0.5; accepted: a whole number from 0 to 9007199254740992"),
        ("drives.winding.initial", math.nan, "winding: initial is nan; accepted: a number in"),
        ("drives.winding.limit", math.nan, "winding: limit is nan; accepted: a finite number >= -273.15"),
        ("drives.winding.resistance[0]", math.inf, "winding: resistance[0] is inf; accepted"),
        ("drives.gear[" + "9" * 5000 + "]", 1.0, "is not a path; accepted: such as friction.joint_2.c0"),
        ("arm.seed", math.nan, "arm.seed is nan; accepted: a whole number from 0 to 9007199254740992"),
        ("arm.seed", math.inf, "arm.seed is inf; accepted: a whole number from 0 to 9007199254740992"),
    ],
)
def test_wrong_values_of_parts_are_refused(parted: Setup, path: str, value: float, said: str) -> None:
    """A value that a part does not take is refused with element, part and range; so is a part that is not there."""
    with pytest.raises(ConfigError) as caught:
        rx.with_parameters(parted, {path: value})
    assert said in str(caught.value)


def test_the_seed_is_the_plants(parted: Setup) -> None:
    """The seed of a setup is a parameter, a whole number that the plant takes."""
    setup = rx.with_parameters(parted, {"arm.seed": 12})
    assert setup.seed == 12
    assert setup.plant().constants["parts"]["scatter"]["seed"][0] == 12
    for seed in (-1, "a", 0.5, True, 2**53 + 1):
        with pytest.raises(ConfigError, match=f"seed is {seed!r}; accepted: a whole number from 0"):
            replace(parted, seed=seed)
    with pytest.raises(TypeError, match="path is of type int; accepted: str"):
        rx.with_parameters(parted, {5: 1.0})  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match="seed is 'a'"):
        rx.load_setup(seed="a")  # type: ignore[arg-type]


def test_numpy_s_scalars_are_numbers(parted: Setup) -> None:
    """A scalar of NumPy's, of whatever type, counts as Python's number of its value, and stays a plain one."""
    path = "friction.joint_2.load.driving"
    for value in (np.float32(0.25), np.float64(0.25), np.int64(0), np.float16(0.25)):
        driving = rx.with_parameters(parted, {path: value}).friction["joint_2"].load.driving
        assert (type(driving), driving) == (float, float(value))
        for name in ("c2", "tau_s_positive"):
            made = replace(parted.friction["joint_2"], **{name: value + type(value)(64)})
            assert (type(getattr(made, name)), getattr(made, name)) == (float, float(value) + 64.0)
        assert type(LoadPart(value, value).driven) is float
    off = rx.with_parameters(parted, {"controller.feed_forward.coulomb": np.bool_(False)})
    assert off.controller.feed_forward.coulomb is False
    for value in (np.float32("nan"), np.bool_(True), "0.25"):
        with pytest.raises(ConfigError, match=r"accepted: a (finite )?number"):
            LoadPart(value, 0.1)  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match=r"accepted: a (finite )?number >= 0"):
            replace(parted.friction["joint_2"], c2=value)


def test_friction_must_not_follow_the_load_faster_than_the_step(parted: Setup) -> None:
    """A relax_time below the plant's step is refused by its path, and taken with shorter steps."""
    quick = rx.with_parameters(parted, {"friction.joint_2.load.relax_time": 1e-4})
    with pytest.raises(
        ConfigError, match=r"friction\.joint_2\.load\.relax_time is 0.0001 s; accepted: at least the pl"
    ):
        quick.plant()
    quick.plant(substeps=4)
