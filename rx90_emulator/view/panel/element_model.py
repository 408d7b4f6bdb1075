"""A small model of one friction element: its Stribeck curve, its presliding loop, and the file with it changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parameters import FRICTION_UNITS
from rx90_common.friction.tracing import prescribed_torque

_CURVE = 160  # points for each sign of the velocity
_LEG = 120  # steps from one reversal to the other
_PERIOD = 2.0  # s, of the motion to and fro: so slow that what is seen is the bristle, not c1 and c2


class StribeckCurve(NamedTuple):
    """Velocity, rad/s, and torque after a long time at it, Nm, each of shape (n,)."""

    velocity: Array
    torque: Array


class PreslidingLoop(NamedTuple):
    """Torques along a motion to and fro, Nm, and the displacement of both, rad, each of shape (n,)."""

    displacement: Array
    forth: Array
    back: Array


def stribeck_curve(element: FrictionElement, top: float) -> StribeckCurve:
    """Return the steady torque up to a velocity of either sign, rad/s, with more points where it is small."""
    speed = top * np.linspace(0.0, 1.0, _CURVE + 1)[1:] ** 3
    velocity = np.concatenate([-speed[::-1], [0.0], speed])
    return StribeckCurve(velocity, element.steady_torque(velocity))


def presliding_loop(element: FrictionElement, amplitude: float) -> PreslidingLoop:
    """Return the closed loop of torque and displacement between two reversals, by the steps of the simulation.

    Args:
        element: the element.
        amplitude: half the way from one reversal to the other, rad.
    """
    legs = 41  # of which the first is half a way, and the last two have forgotten it
    step = _PERIOD / 2.0 / _LEG
    sign = np.repeat((-1.0) ** np.arange(legs), _LEG)[_LEG // 2 :]
    velocity = sign * 2.0 * amplitude / (_LEG * step)
    torque = prescribed_torque((element,), velocity[:, None], np.full(velocity.size, step))[:, 0]
    back, forth = torque[-2 * _LEG : -_LEG], torque[-_LEG:]
    middle = amplitude * ((np.arange(_LEG) + 0.5) * 2.0 / _LEG - 1.0)
    return PreslidingLoop(middle, forth, back[::-1])


def break_away(element: FrictionElement) -> float:
    """Return the displacement at which the linear bristle has the static torque, rad."""
    return max(element.tau_s_positive, element.tau_s_negative) / element.c0


def changed(file: FrictionFile, name: str, values: Mapping[str, float]) -> FrictionFile:
    """Return a friction file with attributes of one element changed by hand, which its head says.

    Raises:
        ConfigError: for a value that the element refuses, with what is accepted.
    """
    before = file.elements[name]
    element = replace(before, **values)  # type: ignore[arg-type]  # of the parameters that are numbers
    edits = [
        f"{name}.{key} from {getattr(before, key):g} to {getattr(element, key):g} {unit}"
        for key, unit in FRICTION_UNITS.items()
        if getattr(element, key) != getattr(before, key)
    ]
    if not edits:
        return file
    of_file = f"the other values {file.provenance or 'of unknown provenance'}"
    source = f"changed by hand: {', '.join(edits)}; {of_file}: {file.source or 'no source'}"
    return FrictionFile({**file.elements, name: element}, "assumed", source)
