"""The files of a robot whose inertias, drives and friction were identified: a URDF, drives, friction and controller."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml, without_schema_line, yaml_text
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import listed, plain
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.description.wrist import element_matrix
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_common.friction.friction_set import element_names
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import IdentifiedElement
from rx90_emulator.identification.excitation.bodies import central
from rx90_emulator.identification.excitation.consistency import ConsistentInertias
from rx90_emulator.identification.excitation.result import ASSUMED_BRISTLES, ExcitationIdentification
from rx90_emulator.identification.output.friction_file import elements_text
from rx90_emulator.identification.records import BagSource

_ORIGIN_KEYS = ("provenance", "source")
_OTHERS = "others"
"""Stands for the keys that are not named."""


class Identified(NamedTuple):
    """A value to write: plain data, the provenance of it, and the sentence that names its source."""

    value: Any
    provenance: str
    source: str


def marked(block: Mapping[str, Any], new: Mapping[str, Identified]) -> dict[str, Any]:
    """Return a block with new values; where not all keys have one `provenance` or `source`, these name the keys."""
    content = {key: value for key, value in block.items() if key not in (*_ORIGIN_KEYS, "note")}
    content |= {key: one.value for key, one in new.items()}
    about = {}
    for word in _ORIGIN_KEYS:
        given = block.get(word)
        each = {key: given.get(key, given.get(_OTHERS)) if isinstance(given, dict) else given for key in content}
        each |= {key: getattr(one, word) for key, one in new.items()}
        if any(value is not None for value in each.values()):
            about[word] = _named(each)
    note = {"note": block["note"]} if "note" in block else {}
    return about | note | content


def _named(each: Mapping[str, str | None]) -> str | dict[str, str] | None:
    """Return what all keys have, or a mapping; what most of several keys have stands under `others`."""
    (most, count), *rest = Counter(each.values()).most_common()
    if not rest:
        return most
    said = {key: value for key, value in each.items() if value is not None}
    if most is None or len(said) < len(each) or count == rest[0][1]:
        return said
    return {**{key: value for key, value in said.items() if value != most}, _OTHERS: most}


_MAX_MASS = 1e5  # kg
_MAX_LEVER = 100.0  # m from the link's frame to its centre of mass
_MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def with_inertials(urdf: str, bodies: Mapping[str, Array | None], remark: str) -> str:
    """Return the URDF with other inertials.

    Args:
        urdf: a well-formed description.
        bodies: by links, the pseudo-inertia in the frame of the link, shape (4, 4), or None for no <inertial>.
        remark: a comment to put before the first element.

    Raises:
        IdentificationError: for a link that is not there, and for a body that no link can be.
    """
    data = urdf.encode("utf-8")
    places = _Places(data)
    edits = [(places.first, places.first, f"<!-- {remark.strip().replace('--', '- -')} -->\n  ".encode())]
    for link, pseudo in bodies.items():
        if link not in places.links:
            raise IdentificationError(f"no link {plain(link)} in the URDF; accepted: {', '.join(places.links)}")
        text = "" if pseudo is None else _inertial(link, pseudo)
        edits.append(places.edit(link, text))
    for start, end, new in sorted(edits, reverse=True):
        data = data[:start] + new + data[end:]
    return data.decode("utf-8")


def _inertial(link: str, pseudo: Array) -> str:
    """Return the element, its numbers to the last bit: what is loaded is what was identified."""
    mass, center, inertia = central(pseudo)
    if not (np.isfinite(pseudo).all() and 0.0 < mass < _MAX_MASS and np.linalg.norm(center) < _MAX_LEVER):
        raise IdentificationError(
            f"link {plain(link)} would have a mass of {mass:.3g} kg at {np.linalg.norm(center):.3g} m; accepted: up to "
            f"{_MAX_MASS:g} kg and {_MAX_LEVER:g} m"
        )
    place = " ".join(repr(float(value)) for value in center)
    moments = " ".join(f"{key}={quoteattr(repr(float(inertia[index])))}" for key, index in _MOMENTS.items())
    return (
        f'<inertial>\n      <origin xyz="{place}" rpy="0 0 0"/>\n      <mass value="{mass!r}"/>\n'
        f"      <inertia {moments}/>\n    </inertial>"
    )


class _Places:
    """Where in the bytes of a URDF the links and their inertials stand.

    Attributes:
        first: beginning of the first element inside the root.
        links: beginning of what follows the content of each link: its end tag, or what follows an empty element.
        inertials: beginning and end of the <inertial> of the links that have one.
    """

    def __init__(self, data: bytes) -> None:
        self.first = 0
        self.links: dict[str, int] = {}
        self.inertials: dict[str, tuple[int, int]] = {}
        self._data, self._path, self._link, self._begun = data, [""], "", 0
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.Parse(data, True)

    def edit(self, link: str, text: str) -> tuple[int, int, bytes]:
        """Return beginning, end and new content of the bytes that give a link this <inertial>, or none."""
        at = self.links[link]
        if link in self.inertials:
            return (*self.inertials[link], text.encode())
        if not text:
            return at, at, b""
        if self._data[at - 2 : at] == b"/>" and not self._data[at:].startswith(b"</link"):
            return at - 2, at, f">\n    {text}\n  </link>".encode()
        return at, at, f"  {text}\n  ".encode()

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        at = self._parser.CurrentByteIndex
        if len(self._path) == 2 and not self.first:
            self.first = at
        self._path.append(name)
        if self._path[2:] == ["link"]:
            self._link = attributes.get("name", "")
        if self._path[2:] == ["link", "inertial"]:
            self._begun = at

    def _end(self, name: str) -> None:
        at = self._parser.CurrentByteIndex
        if self._path[2:] == ["link"]:
            self.links[self._link] = at
        if self._path[2:] == ["link", "inertial"]:
            # Expat tells the beginning of an end tag, and the end of an empty element.
            tag = self._data[at:].startswith(f"</{name}".encode())
            self.inertials[self._link] = (self._begun, self._data.index(b">", at) + 1 if tag else at)
        self._path.pop()


_DRIVES_HEAD = """\
# Drives, with what was identified. "joint side" values are seen through the gear; rotor_inertia, spring, brake and
# end_stops are joint side, torque_constant and peak_current motor side. SI units and A. `provenance` and `source` hold
# for the whole block, or name each value. Names of bags are those of the friction file.
"""
_CONTROLLER_HEAD = """\
# The controller, with the identified friction in its feed-forward; everything else is as it was before.
# Joint-side units, one value per motor (docs/explanation/closed_loop.md).
"""
_SECOND_SPEED_SHARE = (
    0.25  # of the nominal speed: where the compensation of two viscous parts meets their sum a second time
)


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What runs told of a robot, as far as its files hold it.

    Attributes:
        arm: n joints and the friction elements.
        inertias: of links, rotors and springs.
        standard: names of the P standard parameters of `inertias`, as `StandardColumns.names` has them.
        elements: of the friction, in the arm's order.
        fallback_name: file of the values that the runs do not identify, if any.
        sources: the bags that inertias and drives rest on.
        drives: other values for the drives file, by block and key, such as ("motor", "torque_constant").

    Raises:
        IdentificationError: for a value that no file may hold.
    """

    arm: RigidArm
    inertias: ConsistentInertias
    standard: tuple[str, ...]
    elements: tuple[IdentifiedElement, ...]
    fallback_name: str | None
    sources: tuple[BagSource, ...]
    drives: Mapping[tuple[str, str], Identified] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not np.isfinite(self.inertias.parameters).all():
            raise IdentificationError("inertial parameters that are not finite; nothing is written")
        for name, value in zip(self.arm.names, self._amounts("k")[0].tolist(), strict=True):
            if value < 0.0:
                raise IdentificationError(f"the spring of {name} was identified as {value:.3g} Nm; accepted: >= 0")

    def _amounts(self, kind: str) -> tuple[Array, list[str]]:
        """Return the parameters of a kind at each joint, 0 where there is none, and the joints where it is in a sum."""
        amount, shared = np.zeros(len(self.arm.names)), []
        for joint, name in enumerate(self.arm.names):
            if (column := f"{kind}_{joint + 1}") in self.standard:
                k = self.standard.index(column)
                amount[joint] = self.inertias.parameters[k]
                shared += [] if self.inertias.alone[k] else [name]
        return amount, shared

    def identified_drives(self) -> dict[tuple[str, str], Identified]:
        """Return rotors and springs as values for the drives file, by block and key."""
        found = {}
        for kind, block, key in (("Ia", "transmission", "rotor_inertia"), ("k", "spring", "torque")):
            amount, shared = self._amounts(kind)
            if any(name.startswith(f"{kind}_") for name in self.standard):
                how = (
                    f"; of {listed(shared)} only the sum with the links, divided near to what was known"
                    if shared
                    else ""
                )
                found[block, key] = Identified(_plain_numbers(amount), "identified", self.origin + how)
        return found

    @property
    def origin(self) -> str:
        """Return the bags with the dates of recording, in words."""
        return "identified from " + listed(f"{bag.path.name} (recorded {bag.recorded})" for bag in self.sources)


def folder_base(arm: RigidArm, urdf: Path) -> tuple[RobotFiles | None, str]:
    """Return the files that another robot's folder begins with, or None, and in one line what follows from that."""
    if arm.element_matrix.shape != element_matrix().shape or (arm.element_matrix != element_matrix()).any():
        kind = "arms of six joints whose sixth motor turns with joints 5 and 6"
        return None, f"URDF and friction file alone, no robot folder: the simulation has {kind}"
    try:
        load_robot(urdf)
    except ConfigError as error:
        return None, f"URDF and friction file alone, no robot folder: {error}"
    files = RobotFiles(urdf=urdf, tool=None, task=None, poses=None)
    return files, f"drives and controller are those of {files.drives.parent.name} but for what was identified or given"


def robot_texts(
    robot: IdentifiedRobot, urdf: Path, base: RobotFiles | None, now: datetime | None = None
) -> dict[str, str]:
    """Return the text of each file by its name.

    Args:
        robot: what was identified.
        urdf: the description that is given other inertials.
        base: files of the robot that a whole folder is made from; None for URDF and friction file alone.
        now: date of the identification; by default the present.

    Raises:
        IdentificationError: for a body that no link can be.
        ConfigError: for a file of the base that cannot be used.
    """
    names = robot.arm.element_names if base is None else element_names(robot.arm.names)
    texts = {
        FILES["urdf"]: _urdf(robot, urdf.read_text(encoding="utf-8")),
        FILES["friction"]: elements_text(names, robot.elements, robot.fallback_name, now),
    }
    if base is not None:
        texts[FILES["drives"]] = _DRIVES_HEAD + yaml_text(_drives(robot, base.drives))
        limits = load_robot(base.urdf, base.tool).max_velocity
        texts[FILES["controller"]] = _CONTROLLER_HEAD + yaml_text(_controller(robot, base.controller, limits))
        for role in ("tool", "task", "poses"):
            path: Path | None = getattr(base, role)
            if path is not None:
                texts[FILES[role]] = without_schema_line(path.read_text(encoding="utf-8"))
    return texts


def _urdf(robot: IdentifiedRobot, text: str) -> str:
    inertias, prior = robot.inertias, robot.inertias.prior
    new: dict[str, Array | None] = dict.fromkeys(prior.dropped)
    for body, pseudo in zip(prior.bodies, inertias.pseudo, strict=True):
        inverse = np.linalg.inv(body.frame)
        new[body.link] = inverse @ pseudo @ inverse.T
    rotors = ", ".join(f"{value:.6g}" for value in inertias.rotors)
    remark = f" The inertials of {listed(new, 100)} are {robot.origin}; other comments on masses are older. "
    remark += f"Rotors are no part of them: {rotors} kg m^2 at the joints. " if rotors else ""
    return with_inertials(text, new, remark)


def _drives(robot: IdentifiedRobot, path: Path) -> dict[str, Any]:
    new = {**robot.identified_drives(), **robot.drives}
    content = dict(load_yaml(path).content)
    for block in dict.fromkeys(block for block, _ in new):
        content[block] = marked(content[block], {key: one for (there, key), one in new.items() if there == block})
    return content


def _controller(robot: IdentifiedRobot, path: Path, speed: Array) -> dict[str, Any]:
    """Return the controller with the friction that each motor turns against, at speeds up to the nominal ones."""
    elements = [one.element for one in robot.elements]
    turned = [[element] for element in elements[:6]]
    turned[5].append(elements[6])
    viscous = [viscous_sum(some, float(top)) for some, top in zip(turned, speed, strict=True)]
    source = "the identified friction of each joint; of joint 6 and of element 7, with which motor 6 turns as well"
    coulomb = [sum(0.5 * (one.tau_c_positive + one.tau_c_negative) for one in some) for some in turned]
    new = {
        "coulomb_torque": Identified(_plain_numbers(coulomb), "derived", source),
        "viscous_friction": Identified(_plain_numbers([c2 for c2, _ in viscous]), "derived", source),
        "viscous_exponent": Identified(_plain_numbers([alpha for _, alpha in viscous]), "derived", source),
    }
    # Its model, for the feed-forward by one, is the folder's own arm: not the one that the base names.
    content = {key: value for key, value in load_yaml(path).content.items() if key != "model"}
    return content | {"feed_forward": marked(content["feed_forward"], new)}


def viscous_sum(elements: Sequence[FrictionElement], speed: float) -> tuple[float, float]:
    """Return c2 and alpha of one viscous part that has the sum of several at the speed and at a share of it."""
    if len({one.alpha for one in elements}) == 1:
        return sum(one.c2 for one in elements), elements[0].alpha
    fast, slow = (sum(one.c2 * v**one.alpha for one in elements) for v in (speed, _SECOND_SPEED_SHARE * speed))
    alpha = float(np.clip(np.log(slow / fast) / np.log(_SECOND_SPEED_SHARE), *ALPHA_BOUNDS)) if slow > 0.0 else 1.0
    return fast / speed**alpha, alpha


def _plain_numbers(values: Sequence[float] | Array) -> list[float]:
    """Return plain numbers of twelve digits: the others are rounding errors."""
    return [float(f"{value:.12g}") for value in values]


def robot_files(result: ExcitationIdentification, date: datetime) -> tuple[dict[str, str], str]:
    """Return the text of each file by its name, and in one line what they are.

    Args:
        result: what was identified.
        date: of the identification.

    Raises:
        Rx90Error: for a value that no file may hold.
    """
    problem, options, setup = result.problem, result.options, result.robot.setup
    drives = {}
    base: RobotFiles | None
    if setup is not None:
        files = setup.files or RobotFiles()
        urdf, base, note = files.urdf, files, "a robot folder; what the runs do not tell is as it was"
    else:
        urdf = Path(str(options.urdf))
        base, note = folder_base(problem.arm, urdf)
        if options.gear is not None:
            drives["transmission", "gear"] = _given(options.gear, "gear")
            if options.torque_constant is not None:
                drives["motor", "torque_constant"] = _given(options.torque_constant, "torque-constant")
    constants = torque_constants(result)
    if constants is not None:
        drives["motor", "torque_constant"] = constants
    robot = IdentifiedRobot(
        problem.arm,
        result.consistency.inertias,
        problem.columns.names,
        result.elements,
        result.robot.fallback_name or ASSUMED_BRISTLES,
        tuple(bag for use, bag in result.bags if use == "excitation"),
        drives,
    )
    return robot_texts(robot, urdf, base, date), note


def torque_constants(result: ExcitationIdentification) -> Identified | None:
    """Return the motors' torque constants with identified drive gains; None where nothing tells them.

    Efforts of another robot that are no currents of its motors tell gains, but no constants.
    """
    gains, setup, options = result.gains, result.robot.setup, result.options
    if gains is None or (setup is None and (options.gear is None or options.torque_constant is None)):
        return None
    before = options.torque_constant if setup is None else setup.drives.torque_constant
    values = np.asarray(before, dtype=np.float64) * gains.factor
    sure = [name for name, one in zip(result.problem.arm.names, gains.deviation, strict=True) if np.isfinite(one)]
    rest = "" if len(sure) == len(values) else "; the others are as before, for the payload does not tell them"
    odd = [result.problem.arm.names[k] for k in gains.implausible]
    rest += f"; {listed(odd)} hardly to be believed: parameters.yaml says why" if odd else ""
    return Identified(
        [float(f"{value:.6g}") for value in values], "identified",
        f"torques of {listed(sure)} in runs with and without a known payload{rest}",
    )  # fmt: skip


def _given(values: Sequence[float], option: str) -> Identified:
    return Identified([float(value) for value in values], "assumed", f"as given with --{option}")
