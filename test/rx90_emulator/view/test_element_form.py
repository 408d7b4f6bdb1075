"""The small model of a friction element on the page, against the equations written down otherwise."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lugre_oracle import LuGreOracle

from rx90_common.base.errors import ConfigError
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_PARAMETERS
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.element_form import (
    break_away,
    changed,
    presliding_loop,
    read_values,
    stribeck_curve,
    typed_values,
)

ELEMENT = FrictionElement(25.0, 24.0, 32.0, 36.0, 0.05, 1.3, 1e5, 100.0, 14.0, alpha=0.7)


def test_the_curve_is_that_of_the_equations() -> None:
    """At every velocity the curve is equation 18 with the deflection at which equation 17 stands still."""
    velocity, torque = stribeck_curve(ELEMENT, 1.0)
    moving = velocity != 0.0
    assert (velocity[0], velocity[-1], np.diff(velocity).min() > 0.0) == (-1.0, 1.0, True)
    oracle = LuGreOracle([ELEMENT])
    for v, expected in zip(velocity[moving][::20], torque[moving][::20], strict=True):
        speed = np.array([v])
        at_rest = np.sign(speed) * oracle.stribeck(speed) / ELEMENT.c0
        assert oracle.rates(at_rest, speed)[1][0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("share", [0.3, 1.0, 4.0])
def test_the_loop_is_the_periodic_solution_of_equation_17(share: float) -> None:
    """Between two reversals at +-a the deflection is s - (s + s tanh(a/s)) exp(-x/s), s that of steady sliding."""
    element = replace(ELEMENT, tau_c_negative=25.0, tau_s_negative=32.0, c1=40.0)
    way = share * break_away(element)
    displacement, forth, back = presliding_loop(element, way)
    speed = 2.0 * way  # to and fro in 2 s
    oracle = LuGreOracle([element])
    sliding = float(oracle.stribeck(np.array([speed]))[0]) / element.c0
    start = sliding * math.tanh(way / sliding)
    z = sliding - (sliding + start) * np.exp(-(displacement + way) / sliding)
    expected = [float(oracle.rates(np.array([each]), np.array([speed]))[1][0]) for each in z]
    np.testing.assert_allclose(forth, expected, atol=1e-3 * abs(element.tau_s_positive))
    np.testing.assert_allclose(back, -np.array(forth[::-1]), rtol=1e-6, atol=1e-6)


def test_a_changed_element_is_marked_and_read_back(tmp_path: Path, shipped: Setup) -> None:
    """The file with a change says which values were changed by hand, is assumed, and gives the element back."""
    assert shipped.friction.file is not None
    file = replace(FrictionFile.read(shipped.friction.file), provenance="identified", identification={"bags": 3})
    after = changed(file, "joint_2", {"tau_s_negative": 41.5, "c1": 100.0})
    assert after.elements["joint_2"] == replace(file.elements["joint_2"], tau_s_negative=41.5)
    assert (after.provenance, after.identification) == ("assumed", None)
    assert str(after.source).startswith(
        "changed by hand: joint_2.tau_s_negative from 36 to 41.5 Nm; the other values identified"
    )
    path = tmp_path / "friction.yaml"
    path.write_text(after.text(), encoding="utf-8")
    assert FrictionFile.read(path) == after
    assert changed(file, "joint_2", {"c1": 100.0}) is file


def test_typed_values_come_back_and_others_are_refused() -> None:
    """What the fields show is what they are read as, also per sign and infinite; the rest names value and range."""
    element = replace(ELEMENT, omega_d=math.inf)
    texts = list(typed_values(element))
    assert FrictionElement(**read_values(texts)) == element
    assert texts[:2] == ["25 24", "32 36"]
    assert [p.name for p in FRICTION_PARAMETERS][4] == "c0"
    texts[4] = "1e5 x"
    with pytest.raises(ConfigError, match="c0 is '1e5 x'; accepted: a number > 0"):
        read_values(texts)
    texts[4], texts[0] = "1e5", "33 24"
    with pytest.raises(ConfigError, match=r"tau_s_positive is 32.0; accepted: a number >= tau_c_positive = 33.0 Nm"):
        replace(element, **read_values(texts))
