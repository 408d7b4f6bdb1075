"""Setups whose controller feeds forward by a model of its own, right or wrong."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.law.model import ModelFiles
from rx90_emulator.loop.setup import Setup


def by_model(setup: Setup, *, inverse_dynamics: bool = True, friction_model: bool = True) -> Setup:
    switches = {"inverse_dynamics": inverse_dynamics, "friction_model": friction_model}
    return dataclasses.replace(setup, controller=setup.controller.replaced(feed_forward=switches))


def with_friction(setup: Setup, elements: Sequence[FrictionElement], path: Path) -> Setup:
    names = setup.friction.names
    path.write_text(FrictionFile(elements=dict(zip(names, elements, strict=True))).text(), encoding="utf-8")
    model = setup.controller.model
    assert isinstance(model, ModelFiles)
    other = model.replaced(friction=path)
    return dataclasses.replace(setup, controller=setup.controller.replaced(model=other))


def scaled(friction: FrictionSet, factor: float) -> tuple[FrictionElement, ...]:
    names = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c0", "c1", "c2")
    return tuple(
        element.with_parameters({name: factor * element.parameters[name] for name in names})
        for element in friction.elements
    )
