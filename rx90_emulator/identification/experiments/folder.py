"""The folder of a series of experiments: a bag of each, an index of them by use, and the friction of an emulator."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.config import load_yaml, yaml_text
from rx90_common.base.entries import LEFT_OUT, Texts
from rx90_common.base.errors import IdentificationError
from rx90_common.base.groups import Group
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.files import write_text
from rx90_emulator.identification.experiments.plan import Experiment, Kind

INDEX = "experiments.yaml"
EMULATED = "emulated_friction.yaml"
"""The friction that made the runs of a folder; beside runs of the emulator alone."""

EXPERIMENTS = Group(
    "The bags of a series of experiments by use, as rx90_experiment writes it: names in the same folder.",
    keys={
        str(Kind.SLIDING): Texts("Sweeps at constant velocity."),
        str(Kind.PRESLIDING): Texts("Micro-oscillations."),
        str(Kind.EXCITATION): Texts("Excitation runs; left out where there are none.", default=LEFT_OUT),
        str(Kind.VALIDATION): Texts("Runs for the validation."),
    },
)
"""What the index of a series holds."""

_WITH_SET_POINTS = ("motor_states", "rx90_controller/reference", "robot_description")
TOPICS = {
    Kind.SLIDING: ("joint_states", "robot_description"),
    Kind.PRESLIDING: ("motor_states", "robot_description"),
    Kind.EXCITATION: _WITH_SET_POINTS,
    Kind.VALIDATION: _WITH_SET_POINTS,
}
"""What is recorded: sweeps do not need the base rate, which keeps their bags small.

Excitation runs and the validation do: each period of the set-points begins with a jump of torque that grows with the
acceleration, and samples in step with the set-points always fall on that jump."""


@dataclass(frozen=True)
class IdentificationBags:
    """Bags by use: sweeps, micro-oscillations, runs for the validation, and excitation runs."""

    sliding: tuple[Path, ...]
    presliding: tuple[Path, ...] = ()
    validation: tuple[Path, ...] = ()
    excitation: tuple[Path, ...] = ()

    @classmethod
    def of(
        cls,
        sliding: Iterable[Path | str],
        presliding: Iterable[Path | str] = (),
        validation: Iterable[Path | str] = (),
    ) -> IdentificationBags:
        """Return bags given by their names."""
        return cls(*(tuple(Path(bag) for bag in bags) for bags in (sliding, presliding, validation)))


def write_index(folder: Path, done: Sequence[Experiment]) -> None:
    """Write the uses of the bags recorded so far; after each experiment, so that a series may be cut short.

    Raises:
        Rx90Error: if it cannot be written.
    """
    there = [kind for kind in Kind if kind is not Kind.EXCITATION or any(one.kind is kind for one in done)]
    content = {str(kind): [e.name for e in done if e.kind is kind] for kind in there}
    write_text(folder / INDEX, yaml_text(content))


def write_emulated(folder: Path, friction: FrictionSet) -> None:
    """Write the friction that runs were made with, to stand beside what is identified from them.

    Raises:
        Rx90Error: if it cannot be written.
    """
    elements = dict(zip(friction.names, friction.elements, strict=True))
    text = FrictionFile(elements, "assumed", "the emulator made the runs beside this file with it").text()
    write_text(folder / EMULATED, text)


def read_emulated(bags: Iterable[Path]) -> dict[str, FrictionElement]:
    """Return the friction that all bags were made with, by element; none where that is not known of all of them.

    Raises:
        ConfigError: if it is no friction file.
    """
    places = {bag.absolute().parent / EMULATED for bag in bags}
    found = [dict(FrictionFile.read(place).elements) if place.is_file() else {} for place in sorted(places)]
    return found[0] if all(one == found[0] for one in found) else {}


def read_index(folder: Path) -> IdentificationBags:
    """Return the bags of a series.

    Raises:
        IdentificationError: if the folder holds no index, or a bag is missing.
        ConfigError: if the index is no such file.
    """
    if not os.path.lexists(folder / INDEX):
        raise IdentificationError(f"{folder}: no {INDEX}; accepted: a folder that rx90_experiment wrote, or --sliding, "
                                  "--presliding and --validation")  # fmt: skip
    found = {}
    for kind, names in EXPERIMENTS.read(load_yaml(folder / INDEX)).items():
        found[kind] = bags = tuple(folder / name for name in names)
        for bag in bags:
            if not bag.exists():
                raise IdentificationError(f"{folder / INDEX} names {bag.name}, which is not there")
    return IdentificationBags(**found)
