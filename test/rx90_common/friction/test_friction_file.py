"""The friction file: what is refused, in which words, and what is warned of."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.coupling import RX_WRIST
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction import FrictionElement, load_friction
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_emulator.loop.setup import Setup

Edit = Callable[..., Path]
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
ELEMENTS = (*NAMES, "joint_5_6")


def refusal(path: Path) -> str:
    return refusal_by(lambda file: load_friction(file, RX_WRIST.element_names(NAMES)), path)


def test_the_shipped_file_says_that_it_is_assumed_and_is_passive(shipped: Setup, shipped_files: RobotFiles) -> None:
    """The shipped set carries its provenance and gives no passivity warning at any joint speed."""
    assert "provenance: assumed" in shipped_files.friction.read_text()
    assert shipped.friction.names == ELEMENTS
    assert shipped.friction.passivity_warnings(shipped.drives.turning.reach(shipped.robot.max_velocity)) == []


def test_a_damping_not_passive_is_warned_of(shipped: Setup, shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """The paper's constant c1 gives one line with file, element, value and the c1 that is accepted."""
    path = edited_yaml(shipped_files.friction, ("elements", "joint_1", "omega_d"), None, remove=True)
    friction = load_friction(path, RX_WRIST.element_names(NAMES))
    speeds = shipped.drives.turning.reach(shipped.robot.max_velocity)
    (line,) = friction.passivity_warnings(speeds)
    assert line.startswith(f"{path}: elements.joint_1.c1 is 100 ")
    assert "\n" not in line
    # At full speed the Stribeck part is gone: c1 < 4 tau_c / v.
    accepted = 4 * 25.0 / speeds[0]
    assert f"accepted: below {accepted:.3g} " in line
    better = friction.elements[0].replaced(c1=0.99 * accepted)
    assert math.isinf(better.passivity_limit(speeds[0]))


SLIP = {"kind": "maxwell_slip", "stiffness": [0.5, 0.5], "share": [0.4, 0.6], "attraction": 1000.0}
WAVE = {"motor_harmonic": [2], "motor_amplitude": [0.1]}


def waves(*amplitudes: float) -> dict[str, Any]:
    return {"joint_harmonic": [1] * len(amplitudes), "joint_amplitude": [*amplitudes]}


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        *((name, None, f"elements.{name} is missing") for name in ELEMENTS),
        ("joint_1.tau_s", {"positive": 32.0, "negative": 24.5}, "tau_s is 24.5; accepted: a number >= tau_c"),
    ],
)
def test_what_is_wrong_in_a_file_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: str, value: Any, words: str
) -> None:
    """A missing one of the seven elements, and static below Coulomb torque, also of one sign of the velocity."""
    path = edited_yaml(shipped_files.friction, ("elements", *place.split(".")), value, remove=value is None)
    assert words in refusal(path)


@pytest.mark.parametrize(
    ("part", "block", "words"),
    [
        ("ripple", {**WAVE, "motor_phase": [1, 2]}, "ripple.motor_phase is [1.0, 2.0]; accepted: 1 numbers, as many"),
        ("ripple", waves(0.5, 0.5), "amplitudes that sum to less than 1 in both series together"),
        ("bristles", {**SLIP, "stiffness": [0.5, 0.4999]}, "accepted: numbers that sum to 1; these sum to 0.9999"),
        ("bristles", {**SLIP, "share": [1.0]}, "bristles.share is [1.0]; accepted: 2 numbers, as many as stiffness"),
    ],
)
def test_what_is_wrong_in_a_part_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, part: str, block: dict[str, Any], words: str
) -> None:
    """A block whose values do not fit together is refused by file, element, key, value and what is accepted."""
    text = refusal(edited_yaml(shipped_files.friction, ("elements", "joint_2", part), block))
    assert f"elements.joint_2.{part}" in text
    assert words in text


def test_parts_leave_less_to_the_passivity_limit(shipped: Setup) -> None:
    """passive_damping is that of the least sliding torque that ripple and scatter leave; load only adds to it."""
    element, speed = shipped.friction.elements[0], float(shipped.robot.max_velocity[0])
    ripple, scatter = (
        RipplePart(
            joint_harmonic=(1.0,), joint_amplitude=(0.2,), joint_phase=(), motor_harmonic=(2.0,), motor_amplitude=(0.1,)
        ),
        ScatterPart(deviation=0.05, correlation_time=10.0),
    )
    whole = element.passive_damping(speed)
    assert element.replaced(load=LoadPart(driving=0.1, driven=0.2)).passive_damping(speed) == whole
    parted = element.replaced(ripple=ripple, scatter=scatter)
    assert parted.passive_damping(speed) == pytest.approx(0.7 * 0.8 * whole, rel=1e-12)
    with pytest.raises(ConfigError, match=r"^bristles\.kind is missing; accepted: one of"):
        element.replaced(bristles={"count": 3})


def test_velocities_that_can_hardly_be_divided_by() -> None:
    """The least ones that are accepted give no warning."""
    element = FrictionElement(tau_c=25.0, tau_s=32.0, omega_s=0.05, delta=1.0, c0=1e5, c1=100.0, c2=14.0, omega_d=1.0)
    least = element.replaced(
        omega_s=1e-9, omega_d=1e-9, delta=50.0, load=LoadPart(driving=0.1, driven=0.1, omega_s=1e-9)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert least.steady_torque([-6.0, 0.0, 6.0]).tolist() == [-109.0, 0.0, 109.0]
        assert element_arrays([least])["inverse_omega_s"][0] == pytest.approx([1e9])
        assert math.isinf(least.passivity_limit(6.0))
