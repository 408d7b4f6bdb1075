"""The folder of an identified robot: URDF, drives, friction, controller, and all parameters.

A file of the robot that the identification started from is written again with the identified values; each value states
its source.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.config import check_numbers, read_yaml, without_schema_line, yaml_text
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.models import FileModel
from rx90_common.base.quoting import listed, plain
from rx90_common.description.coupling import Coupling
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import ALPHA_BOUNDS
from rx90_emulator.identification.arm import RigidArm, all_joints
from rx90_emulator.identification.bodies import central
from rx90_emulator.identification.estimates import LARGEST, IdentifiedElement, ParameterEstimate, digits
from rx90_emulator.identification.fitted import ASSUMED
from rx90_emulator.identification.output.assumed_files import assumed_files
from rx90_emulator.identification.output.friction_file import FileFacts, elements_text
from rx90_emulator.identification.output.summary import bodies_warnings, in_currents
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import ExcitationIdentification
from rx90_emulator.identification.validation.verdict import RunTorques


class Identified(NamedTuple):
    """A value to write: plain data, its provenance, and the sentence on its source."""

    value: Any
    provenance: str
    source: str


def marked(block: Mapping[str, Any], new: Mapping[str, Identified]) -> dict[str, Any]:
    """Return a block with new values, and with `provenance` and `source` by key where they do not apply to all keys.

    The most frequent entry of several keys is written under `others`, which applies to all keys that are not named.
    """
    content = {key: value for key, value in block.items() if key not in FileModel.about_keys}
    content |= {key: one.value for key, one in new.items()}
    about: dict[str, Any] = {}
    for word in ("provenance", "source"):
        given = block.get(word)
        each = {key: given.get(key, given.get("others")) if isinstance(given, dict) else given for key in content}
        each |= {key: getattr(one, word) for key, one in new.items()}
        (most, count), *rest = Counter(each.values()).most_common()
        stated = {key: value for key, value in each.items() if value is not None}
        if rest and None not in each.values() and count > rest[0][1]:
            stated = {key: value for key, value in each.items() if value != most} | {"others": most}
        if stated:
            about[word] = stated if rest else most
    return about | {key: block[key] for key in ("note",) if key in block} | content


_MAX_MASS = 1e5  # kg
_MAX_LEVER = 100.0  # m from the link's frame to its centre of mass
_MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def edited_urdf(urdf: str, bodies: Mapping[str, Array | None], held: Collection[str], remark: str) -> str:
    """Return a URDF with other inertials; all else, comments too, is as it was.

    Args:
        urdf: a well-formed description.
        bodies: by its links, the pseudo-inertia in the frame of the link, shape (4, 4), or None for no <inertial>.
        held: joints that become fixed.
        remark: a comment to put before the first element.
    """
    root = ET.fromstring(urdf, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    for link in root.findall("link"):
        name = link.get("name", "")
        if name in bodies:
            for inertial in link.findall("inertial"):
                link.remove(inertial)
            pseudo = bodies[name]
            if pseudo is not None:
                link.insert(0, _inertial(name, pseudo))
    for joint in root.findall("joint"):
        if joint.get("name") in held:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    root.insert(0, ET.Comment(remark.replace("--", "- -")))
    return ET.tostring(root, encoding="unicode") + "\n"


def _inertial(link: str, pseudo: Array) -> ET.Element:
    """Return the element with all digits, so that loading it gives exactly the identified values."""
    mass, center, inertia = central(pseudo)
    if not (np.isfinite(pseudo).all() and 0.0 < mass < _MAX_MASS and np.linalg.norm(center) < _MAX_LEVER):
        raise IdentificationError(
            f"link {plain(link)} would have a mass of {mass:.3g} kg at {np.linalg.norm(center):.3g} m; accepted: up to "
            f"{_MAX_MASS:g} kg and {_MAX_LEVER:g} m"
        )
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(map(repr, center.tolist())), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    ET.SubElement(inertial, "inertia", {key: repr(float(inertia[index])) for key, index in _MOMENTS.items()})
    ET.indent(inertial)
    return inertial


_DRIVES_HEAD = """\
# Drives, with what was identified. "joint side" values are seen through the gear; rotor_inertia, spring, brake and
# end_stops are joint side, torque_constant and peak_current motor side. SI units and A. `provenance` and `source` hold
# for the whole block, or name each value. Names of bags are those of the friction file.
"""
_CONTROLLER_HEAD = """\
# The controller, with the identified friction in its feed-forward; everything else is as it was before.
# Joint-side units, one value per motor (docs/explanation/closed_loop.md).
"""
_SECOND_SPEED_SHARE = 0.25
"""Of the nominal speed: where the compensation by one viscous part equals the sum of several a second time."""


def viscous_sum(elements: Sequence[FrictionElement], speed: float) -> tuple[float, float]:
    """Return c2 and alpha of one viscous part that equals the sum of several at the speed and at a share of it."""
    if len({one.alpha for one in elements}) == 1:
        return sum(one.c2 for one in elements), elements[0].alpha
    fast = sum(one.c2 * speed**one.alpha for one in elements)
    slow = sum(one.c2 * (_SECOND_SPEED_SHARE * speed) ** one.alpha for one in elements)
    alpha = float(np.clip(np.log(slow / fast) / np.log(_SECOND_SPEED_SHARE), *ALPHA_BOUNDS)) if slow > 0.0 else 1.0
    return fast / speed**alpha, alpha


class FolderBase(NamedTuple):
    """The files that a robot folder is derived from.

    Attributes:
        robot: the arm before, with its limits.
        turning: its coupling.
        files: of the robot whose drives and controller are the basis, and whose tool, task and poses are kept; None for
            drives and controller that are assumed in proportion to the arm.
        held: joints of the URDF that were at 0 in the identification, and become fixed.
    """

    robot: RobotModel
    turning: Coupling
    files: RobotFiles | None
    held: tuple[str, ...] = ()

    @classmethod
    def of(cls, files: RobotFiles) -> FolderBase:
        """Return that of a robot's files."""
        return cls(load_robot(files.urdf, files.tool), load_drives(files.drives).turning, files)


def folder_base(arm: RigidArm, urdf: Path) -> tuple[FolderBase | None, str]:
    """Return the basis of another robot's folder, or None, and in one line the consequence."""
    alone = "URDF and friction file alone, no robot folder: "
    if not arm.identified.all():
        followed = listed(name for name, own in zip(arm.names, arm.identified, strict=True) if not own)
        return None, f"{alone}{followed} only followed the recording; the simulation needs friction of every joint"
    held = tuple(name for name in all_joints(urdf) if name not in arm.names)
    try:
        robot = load_robot(urdf, held=held, replaced=True)
        turning = Coupling(arm.coupling)
    except ConfigError as error:
        return None, f"{alone}{error}"
    fixed = f"; {listed(held)} fixed at 0, as in the identification" if held else ""
    provenance = "what of drives and controller was not identified or given is assumed, in proportion to the arm"
    return FolderBase(robot, turning, None, held), provenance + fixed


def robot_texts(
    result: ExcitationIdentification,
    urdf: Path,
    base: FolderBase | None,
    given: Mapping[tuple[str, str], Identified] = MappingProxyType({}),
    now: datetime | None = None,
) -> dict[str, str]:
    """Return the text of each file by its name.

    Args:
        result: the identification.
        urdf: the description that gets other inertials.
        base: basis of a whole folder; None for URDF and friction file alone.
        given: other values for the drives file, by block and key, such as ("motor", "torque_constant").
        now: date of the identification; by default the present.
    """
    arm = result.problem.arm
    inertias = result.consistency.inertias
    standard = result.problem.columns.names
    names = arm.names
    if not np.isfinite(inertias.parameters).all():
        raise IdentificationError("inertial parameters that are not finite; nothing is written")
    sources = (bag for use, bag in result.bags if use == "excitation")
    origin = "identified from " + listed(f"{bag.path.name} (recorded {bag.recorded})" for bag in sources)
    new: dict[tuple[str, str], Identified] = {}
    for kind, block, key in (("Ia", "transmission", "rotor_inertia"), ("k", "spring", "torque")):
        columns = {name: f"{kind}_{joint}" for joint, name in enumerate(names, 1)}
        there = {name: standard.index(one) for name, one in columns.items() if one in standard}
        if there and (kind != "Ia" or result.problem.columns.rotors):
            amounts = [float(inertias.parameters[there[name]]) if name in there else 0.0 for name in names]
            shared = listed(name for name, k in there.items() if not inertias.alone[k])
            how = f"; of {shared} only the sum with the links, divided near to what was known" if shared else ""
            new[block, key] = Identified([digits(one, 12) for one in amounts], "identified", origin + how)
            if kind == "k" and min(amounts) < 0.0:
                worst = names[int(np.argmin(amounts))]
                raise IdentificationError(
                    f"the spring of {worst} was identified as {min(amounts):.3g} Nm; accepted: >= 0"
                )
    new |= given
    bodies: dict[str, Array | None] = dict.fromkeys(inertias.prior.dropped)
    for body, pseudo in zip(inertias.prior.bodies, inertias.pseudo, strict=True):
        inverse = np.linalg.inv(body.frame)
        bodies[body.link] = inverse @ pseudo @ inverse.T
    rotors = ", ".join(f"{value:.6g}" for value in inertias.rotors)
    remark = f" The inertials of {listed(bodies, 100)} are {origin}; other comments on masses are older. "
    remark += f"Rotors are no part of them: {rotors} kg m^2 at the joints. " if inertias.rotors.any() else ""
    remark += "".join(f"{text}. " for text in in_currents(result))
    elements = arm.element_names if base is None else base.turning.element_names(names)
    old = result.problem.arm.element_names
    notes = {
        new: result.element_notes[name] for name, new in zip(old, elements, strict=True) if name in result.element_notes
    }
    texts = {
        FILES["urdf"]: edited_urdf(urdf.read_text(encoding="utf-8"), bodies, () if base is None else base.held, remark),
        FILES["friction"]: elements_text(
            elements,
            result.elements,
            result.robot.fallback_name or ASSUMED,
            FileFacts(
                date=now,
                joints=_joints(result),
                warnings=notes,
                speeds=dict(zip(elements, result.fitted.speeds, strict=True)),
                bandwidths=result.compared,
                unit=result.unit,
            ),
        ),
    }
    if base is None:
        return texts
    peak_acceleration = np.max([np.abs(run.acceleration).max(axis=0) for run in result.problem.runs], axis=0)
    drives, controller = _initial_contents(
        base, texts[FILES["urdf"]], np.asarray(inertias.rotors), new, peak_acceleration
    )
    for block in dict.fromkeys(block for block, _ in new):
        drives[block] = marked(drives[block], {key: one for (there, key), one in new.items() if there == block})
    feed_forward = _compensation(result.elements, elements, base)
    controller["feed_forward"] = marked(controller["feed_forward"], feed_forward)
    texts[FILES["drives"]] = _DRIVES_HEAD + yaml_text(drives)
    texts[FILES["controller"]] = _CONTROLLER_HEAD + yaml_text(controller)
    for role in ("tool", "task", "poses"):
        path: Path | None = None if base.files is None else getattr(base.files, role)
        if path is not None:
            texts[FILES[role]] = without_schema_line(path.read_text(encoding="utf-8"))
    return texts


def _compensation(
    found: Sequence[IdentifiedElement], elements: Sequence[str], base: FolderBase
) -> dict[str, Identified]:
    """Return the controller's compensation for the identified friction of the elements with these names."""
    joints = len(base.robot.joint_names)
    # The friction that each motor works against, at speeds up to the nominal ones.
    moved_elements = [[one.element] for one in found[:joints]]
    speed = base.robot.max_velocity.tolist()
    for motor, one in zip(base.turning.sums, found[joints:], strict=True):
        moved_elements[motor].append(one.element)
    viscous, exponent = zip(
        *(viscous_sum(some, top) for some, top in zip(moved_elements, speed, strict=True)), strict=True
    )
    coulomb = [sum(0.5 * (one.tau_c.positive + one.tau_c.negative) for one in some) for some in moved_elements]
    source = "the identified friction of each joint"
    if base.turning.size.wrist:
        source += "; of joint 6 and of element 7, with which motor 6 turns as well"
    elif base.turning.sums:
        source += f", and of {listed(elements[joints:])} at the motors that turn so"
    values = {"coulomb_torque": coulomb, "viscous_friction": viscous, "viscous_exponent": exponent}
    return {key: Identified([digits(one, 12) for one in some], "derived", source) for key, some in values.items()}


def _initial_contents(
    base: FolderBase, urdf: str, rotors: Array, new: Mapping[tuple[str, str], Identified], peak_acceleration: Array
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the initial contents of drives and controller file; accelerations as in the runs."""
    if base.files is None:
        return assumed_files(base.robot, pin.buildModelFromXML(urdf), base.turning, rotors, new, peak_acceleration)
    # The model for its feed-forward is the folder's own arm, not the one named in the basis.
    controller = {key: value for key, value in read_yaml(base.files.controller).items() if key != "model"}
    return dict(read_yaml(base.files.drives)), controller


def _joints(result: ExcitationIdentification) -> dict[str, dict[str, float]]:
    """Return what is identified at each joint beside links and friction; of this project's arms the offset alone.

    Rotors and springs of another arm may be in a drives file, too: its URDF alone is held against bags with these.
    """
    names = result.problem.arm.names
    standard = result.problem.columns.names
    values = dict(zip(standard, result.consistency.inertias.parameters.tolist(), strict=True))
    kinds = {"offset": "offset"} | ({} if result.robot.setup else {"rotor_inertia": "Ia", "spring": "k"})
    found = {
        name: {key: digits(values.get(f"{kind}_{joint}", 0.0)) for key, kind in kinds.items()}
        for joint, name in enumerate(names, 1)
    }
    return {name: kept for name, one in found.items() if (kept := {key: value for key, value in one.items() if value})}


def robot_files(result: ExcitationIdentification, date: datetime) -> tuple[dict[str, str], str]:
    """Return the text of each file by its name, and a line that describes them.

    Args:
        result: the identification.
        date: of the identification.
    """
    problem = result.problem
    options = result.options
    setup = result.robot.setup
    drives: dict[tuple[str, str], Identified] = {}
    if setup is not None:
        base: FolderBase | None = FolderBase.of(setup.files or RobotFiles())
        urdf = (setup.files or RobotFiles()).urdf
        note = "a robot folder; what the runs do not determine is as it was"
    else:
        urdf = Path(str(options.urdf))
        base, note = folder_base(problem.arm, urdf)
        given = {("transmission", "gear"): options.gear, ("motor", "torque_constant"): options.torque_constant}
        for (block, key), values in given.items():
            if options.gear is not None and values is not None:
                provenance = f"as given with --{key.replace('_', '-')}"
                drives[block, key] = Identified([float(value) for value in values], "assumed", provenance)
    return robot_texts(result, urdf, base, drives, date), note


_PARAMETERS_HEAD = """\
# Parameters identified from excitation runs, joint side, SI units; deviation: standard deviation, HAC.
# A base parameter is the combination of inertial parameters in `group`: m mass, mx .. mz first moments, Ixx .. Izz
# inertia about the origin of the link's joint, Ia rotor through its gear, k spring, offset of the torque; numbers are
# those of the joints from the base. The robot's own files in this folder hold what the simulation loads.
"""


def parameters_text(result: ExcitationIdentification, date: datetime, versions: Mapping[str, str]) -> str:
    """Return all results of the runs as one YAML file for programs and for the record.

    Args:
        result: the identification.
        date: of the identification.
        versions: of interpreter and libraries.
    """
    fitted = result.fitted
    bandwidths = result.problem.runs[0].bandwidths
    bodies = result.consistency.inertias
    content: dict[str, Any] = {
        "date": date.isoformat(timespec="seconds"),
        "versions": dict(versions),
        "bags": [
            {"path": str(bag.path), "use": use, "sha256": bag.sha256, "duration": digits(bag.duration)}
            for use, bag in result.bags
        ],
        "bandwidths": _rounded(bandwidths._asdict()),
        "base_parameters": {
            one.name: {"unit": one.unit, "group": one.group, **_estimate(one.estimate)}
            | {"consistent": digits(one.consistent)}
            for one in result.base
        },
        "friction": {
            name: {parameter: _estimate(estimate) for parameter, estimate in one.estimates.items()}
            for name, one in zip(result.problem.arm.element_names, result.elements, strict=True)
        },
        "trials": [
            {
                "element": result.problem.arm.element_names[trial.element],
                "part": trial.part.value,
                "kept": trial.kept,
                "reason": trial.reason,
            }
            for trial in fitted.trials
        ],
        "fit": {run.source.path.name: _torques(run) for run in result.torques},
        "validation": {
            one.torques.source.path.name: {
                "confirmed": one.passed,
                **_torques(one.torques),
                "simplest": _torques(one.simplest),
                "by_files": _torques(one.files),
            }
            for one in result.validations
        },
        "bodies": {
            "distance": digits(bodies.distance),
            "relative_error": digits(result.consistency.shares[1]),
            "masses_not_determined": [
                name for name, one in zip(bodies.prior.joints, bodies.open.tolist(), strict=True) if one
            ],
        },
    }
    deviation = np.where(fitted.determined, fitted.deviation, np.nan)
    correlation = (fitted.covariance / np.outer(deviation, deviation)).tolist()
    content |= {
        "not_determined": list(result.undetermined),
        "remarks": [
            *in_currents(result),
            *result.notes,
            *result.warnings,
            *bodies_warnings(result),
        ],
        "correlation": {
            "names": list(fitted.names),
            "matrix": [[None if math.isnan(share) else round(share, 3) for share in row] for row in correlation],
        },
    }
    check_numbers(content, LARGEST)
    return in_unit(_PARAMETERS_HEAD + yaml_text(content), result.unit)


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with its numbers to six digits, without those that are NaN."""
    rounded = {key: digits(value) if isinstance(value, float) else value for key, value in values.items()}
    return {key: value for key, value in rounded.items() if not (isinstance(value, float) and math.isnan(value))}


def _estimate(estimate: ParameterEstimate) -> dict[str, Any]:
    if not estimate.identifiable:
        return {"identifiable": False, "reason": estimate.reason}
    return {"value": digits(estimate.value), "deviation": digits(estimate.deviation)}


def _torques(run: RunTorques) -> dict[str, Any]:
    figures = [
        _rounded({"rms": rms, "relative": share})
        for rms, share in zip(run.rms.tolist(), run.share.tolist(), strict=True)
    ]
    # A joint without torque has no share of it.
    figures = [{key: value for key, value in row.items() if not value > LARGEST} for row in figures]
    joints = {name: row for name, row in zip(run.names, figures, strict=True) if "rms" in row}
    return {"relative": digits(run.total_share), "joints": joints}
