"""The kind of bristles of each element of an arm, or why it cannot be told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import listed
from rx90_common.friction.parts.bristles import BristlesPart
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.fit import MovedGroup, PreslidingFit
from rx90_emulator.identification.presliding.group_model import joint_groups
from rx90_emulator.identification.presliding.kind_model import FAMILIES
from rx90_emulator.identification.presliding.kinds import (
    MOST_TOGETHER,
    KindChoice,
    KindTrial,
    choose_kinds_of,
    least_motions,
    steps_of,
)
from rx90_emulator.identification.records.record import BagSource

_MOST_MISSED = 0.5  # of the friction torque, by the kind that predicts best, noise included
_MOST_INERTIA = 0.1  # relative error of the joint's inertia
_MOST_REACH = 2.0  # of a block, in parts of the travel: there and back, a block with half of it slips


@dataclass(frozen=True, eq=False)
class ElementKind:
    """What is known of the kind of an element's bristles.

    Attributes:
        element: its name.
        reason: why no kind is told; "" where one is.
        choice: what was tried; None where nothing could be.
        moved: the micro-motions that were compared; None where there are none.
    """

    element: str
    reason: str
    choice: KindChoice | None = None
    moved: MovedGroup | None = None

    @property
    def decision(self) -> str:
        """Return "LuGre", "elasto-plastic", "Maxwell slip", "cannot tell", or "not compared"."""
        if self.choice is None:
            return "not compared"
        return self.choice.best.family.kind if self.told else "cannot tell"

    @property
    def told(self) -> bool:
        """Return whether the data tell it, LuGre's too."""
        return self.choice is not None and not self.reason

    @property
    def trial(self) -> KindTrial | None:
        """Return the trial whose bristles take the place of LuGre's; None where LuGre's stay."""
        if self.choice is None or not self.told or self.choice.best.bristles is None:
            return None
        return self.choice.best

    @property
    def bristles(self) -> BristlesPart | None:
        """Return the bristles that the element gets; None is LuGre's."""
        return None if self.trial is None else self.trial.bristles

    @property
    def sources(self) -> tuple[BagSource, ...]:
        """Return the bags that it rests on."""
        return () if self.moved is None else self.moved.sources

    @property
    def text(self) -> str:
        """Return the decision with how sure it is, or why there is none."""
        if self.choice is None or self.reason:
            return f"{self.decision}: {self.reason}"
        return f"{self.decision}, told from the others by {self.choice.margin:.1f} standard errors or more"

    @cached_property
    def largest(self) -> tuple[Array, dict[str, Array]]:
        """Return position, rad from the mean, and torque of the bristles, Nm, of the largest micro-motion compared.

        The torques are the measured one, that of the best kind and those of the best trial of each other kind, by name.
        """
        assert self.choice is not None
        return _compared(self.choice)


def choose_kinds(
    fit: PreslidingFit, arm: RigidArm, progress: Callable[[str], None] = lambda _: None
) -> tuple[ElementKind, ...]:
    """Return the kind of bristles of each element, in the arm's order.

    Args:
        fit: with LuGre's bristles, of the arm.
        arm: whose elements these are.
        progress: called `kind_steps(arm)` times, with what is done next.
    """
    groups = {moved.elements: moved for moved in fit.groups}
    found: dict[str, ElementKind] = {}
    for group in joint_groups(arm):
        names = [arm.element_names[e] for e in group.elements]
        found |= {kind.element: kind for kind in _of_group(names, groups.get(group.elements), progress)}
    return tuple(found[name] for name in arm.element_names)


def decisions(kinds: Iterable[ElementKind]) -> list[tuple[str, str]]:
    """Return what became of each element in words, elements of which the same is said together."""
    together: dict[str, list[str]] = {}
    for kind in kinds:
        together.setdefault(kind.text, []).append(kind.element)
    return [(", ".join(names), text) for text, names in together.items()]


def kind_steps(arm: RigidArm) -> int:
    """Return how many steps `choose_kinds` takes."""
    return sum(steps_of(len(group.elements), FAMILIES) for group in joint_groups(arm))


def _of_group(names: Sequence[str], moved: MovedGroup | None, progress: Callable[[str], None]) -> list[ElementKind]:
    least, count = least_motions(len(names)), 0 if moved is None else len(moved.motions)
    if moved is None or count < least or len(names) > MOST_TOGETHER:
        for _ in range(steps_of(len(names), FAMILIES)):
            progress(f"{listed(names)}: bristles")
        reason = f"{count} micro-oscillations; {least} or more tell kinds apart"
        if len(names) > MOST_TOGETHER:
            reason = f"{len(names)} elements share joints; accepted: {MOST_TOGETHER} at most"
        return [ElementKind(name, reason) for name in names]
    choices = choose_kinds_of(
        moved.motions, moved.c0, FAMILIES, lambda place, kind: progress(f"{names[place]}: {kind}")
    )
    return [ElementKind(name, _doubt(one), one, moved) for name, one in zip(names, choices, strict=True)]


def _doubt(choice: KindChoice) -> str:
    """Return why no kind is told; "" if one is."""
    best = choice.best
    if best.missed > _MOST_MISSED:
        return f"even the best kind, {best.family.name}, misses {100.0 * best.missed:.0f} % of the friction torque"
    if choice.kind is None:
        return f"the data do not tell {listed([trial.family.name for trial in choice.possible])} apart"
    if abs(best.fit.inertia) > _MOST_INERTIA:
        error = 100.0 * abs(best.fit.inertia)
        return f"the joint's inertia would be {error:.0f} % off the description's: a payload or a rotor may be missing"
    travel = float(np.ptp(choice.position))
    if best.fit.reach > _MOST_REACH * travel:
        return (
            f"Maxwell slip predicts best, but a block would slip only after {1e3 * best.fit.reach:.2g} mrad, and the "
            f"micro-oscillations went through {1e3 * travel:.2g} mrad"
        )
    return ""


def _compared(choice: KindChoice) -> tuple[Array, dict[str, Array]]:
    shown: dict[str, KindTrial] = {}
    for trial in sorted(choice.trials, key=lambda trial: trial.behind):
        shown.setdefault(trial.family.kind, trial)
    torques = {"measured": choice.best.seen[0]}
    torques |= {trial.family.name: trial.seen[1] for trial in shown.values()}
    position = choice.position
    return position - position.mean(), {name: torque - torque.mean() for name, torque in torques.items()}
