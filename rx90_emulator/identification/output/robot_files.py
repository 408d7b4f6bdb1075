"""The folder of an identified robot: URDF, drives, friction, controller, and all parameters.

A file of the robot that the identification started from is written again with the identified values; each value states
its source.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.config import check_numbers, read_yaml, yaml_text
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.models import FileModel
from rx90_common.base.quoting import listed
from rx90_common.base.share import versions
from rx90_common.description.assumed_files import assumed_files
from rx90_common.description.coupling import Coupling
from rx90_common.description.drives import load_drives
from rx90_common.description.joint_model import all_joints
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.bodies import body_of
from rx90_emulator.identification.estimates import (
    LARGEST,
    IdentifiedElement,
    ParameterEstimate,
    digits,
)
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.output.summary import bodies_warnings
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import ExcitationIdentification
from rx90_emulator.identification.validation.prediction import Validation


class Identified(NamedTuple):
    """A value to write: plain data, its provenance, and the sentence on its source."""

    value: Any
    provenance: str
    source: str


def marked(block: Mapping[str, Any], new: Mapping[str, Identified]) -> dict[str, Any]:
    """Return a block with new values, and with `provenance` and `source` for each of its keys."""
    content = {key: value for key, value in block.items() if key not in FileModel.about_keys}
    content |= {key: identified.value for key, identified in new.items()}
    about: dict[str, Any] = {}
    for word in ("provenance", "source"):
        given = block.get(word)
        words = {
            key: given.get(key, given.get("others")) if isinstance(given, dict) else given
            for key in content
        }
        words |= {key: getattr(identified, word) for key, identified in new.items()}
        stated = {key: said for key, said in words.items() if said}
        (first, *others) = set(words.values())
        about[word] = stated if others else first
    note = {"note": block["note"]} if "note" in block else {}
    return about | note | content


_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def edited_urdf(
    urdf: str, bodies: Mapping[str, Array | None], held: Collection[str], remark: str
) -> str:
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
                link.insert(0, _inertial(pseudo))
    for joint in root.findall("joint"):
        if joint.get("name") in held:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    root.insert(0, ET.Comment(remark.replace("--", "- -")))
    return ET.tostring(root, encoding="unicode") + "\n"


def _inertial(pseudo: Array) -> ET.Element:
    """Return the element with all digits, so that loading it gives exactly the identified values."""
    body = body_of(pseudo)
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(map(repr, body.lever.tolist())), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(body.mass)))
    moments = body.inertia[np.triu_indices(3)].tolist()
    ET.SubElement(
        inertial,
        "inertia",
        {key: repr(moment) for key, moment in zip(_MOMENTS, moments, strict=True)},
    )
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
        followed = listed(np.array(arm.names)[~arm.identified].tolist())
        return (
            None,
            f"{alone}{followed} only followed the recording; the simulation needs friction of every joint",
        )
    held = tuple(name for name in all_joints(urdf) if name not in arm.names)
    try:
        robot = load_robot(urdf, held=held, replaced=True)
        turning = Coupling(arm.coupling)
    except ConfigError as error:
        return None, f"{alone}{error}"
    fixed = f"; {listed(held)} fixed at 0, as in the identification" if held else ""
    provenance = "what of drives and controller was not identified or given is assumed, in proportion to the arm"
    return FolderBase(robot, turning, None, held), provenance + fixed


def robot_files(result: ExcitationIdentification) -> tuple[dict[str, str], str]:
    """Return the text of each of the robot's files by its name, and a line that describes them."""
    setup = result.robot.setup
    if setup is not None:
        note = "a robot folder; what the runs do not determine is as it was"
        return robot_texts(result, setup.files.urdf, FolderBase.of(setup.files)), note
    urdf = Path(str(result.robot.options.urdf))
    base, note = folder_base(result.arm, urdf)
    return robot_texts(result, urdf, base), note


def robot_texts(
    result: ExcitationIdentification, urdf: Path, base: FolderBase | None
) -> dict[str, str]:
    """Return the text of each file by its name.

    Args:
        result: the identification.
        urdf: the description that gets other inertials.
        base: basis of a whole folder; None for URDF and friction file alone.
    """
    arm = result.arm
    inertias = result.consistency
    if not np.isfinite(inertias.parameters).all():
        raise IdentificationError("inertial parameters that are not finite; nothing is written")
    names = arm.element_names if base is None else base.turning.element_names(arm.names)
    bandwidths = result.compared
    speeds = zip(names, result.fitted.speeds, strict=True)
    about = {
        "bandwidths": {"position": float(bandwidths.position), "torque": float(bandwidths.torque)},
        "speeds": {name: [digits(low, 3), digits(high, 3)] for name, (low, high) in speeds},
    }
    bodies: dict[str, Array | None] = dict.fromkeys(inertias.prior.dropped)
    for body, pseudo in zip(inertias.prior.bodies, inertias.pseudo, strict=True):
        inverse = np.linalg.inv(body.frame)
        bodies[body.link] = inverse @ pseudo @ inverse.T
    remark = f" The inertials of {listed(bodies, 100)} are {_origin(result)}; other comments on masses are older. "
    if inertias.rotors.any():
        rotors = ", ".join(f"{value:.6g}" for value in inertias.rotors)
        remark += f"Rotors are no part of them: {rotors} kg m^2 at the joints. "
    remark += "".join(f"{text}. " for text in result.in_currents)
    remark = in_unit(remark, result.unit)
    held = () if base is None else base.held
    texts = {
        FILES["urdf"]: edited_urdf(urdf.read_text(encoding="utf-8"), bodies, held, remark),
        FILES["friction"]: friction_text(result, names, about, _joints(result)),
    }
    return (
        texts if base is None else texts | _folder_texts(result, base, names, texts[FILES["urdf"]])
    )


def _origin(result: ExcitationIdentification) -> str:
    bags = (bag for use, bag in result.bags if use == "excitation")
    return "identified from " + listed(f"{bag.path.name} (recorded {bag.recorded})" for bag in bags)


def _folder_texts(
    result: ExcitationIdentification, base: FolderBase, names: Sequence[str], urdf: str
) -> dict[str, str]:
    """Return the texts of drives and controller, and of the files that are kept."""
    new = _drive_values(result)
    if base.files is None:
        options = result.robot.options
        given = {
            ("transmission", "gear"): options.gear,
            ("motor", "torque_constant"): options.torque_constant,
        }
        for (block, key), values in given.items():
            if options.gear is not None and values is not None:
                source = f"as given with --{key.replace('_', '-')}"
                new[block, key] = Identified([float(value) for value in values], "assumed", source)
        fastest = np.max(
            [np.abs(run.acceleration).max(axis=0) for run in result.problem.runs], axis=0
        )
        rotors = result.consistency.rotors
        drives, controller = assumed_files(
            base.robot, pin.buildModelFromXML(urdf), base.turning, rotors, new, fastest
        )
    else:
        drives = dict(read_yaml(base.files.drives))
        # The model for its feed-forward is the folder's own arm, not the one named in the basis.
        controller = {
            key: value for key, value in read_yaml(base.files.controller).items() if key != "model"
        }
    for (block, key), identified in new.items():
        drives[block] = marked(drives[block], {key: identified})
    controller["feed_forward"] = marked(
        controller["feed_forward"], _compensation(result.elements, names, base)
    )
    texts = {
        FILES["drives"]: _DRIVES_HEAD + yaml_text(drives),
        FILES["controller"]: _CONTROLLER_HEAD + yaml_text(controller),
    }
    unchanged = {} if base.files is None else base.files.optional_texts()
    return texts | unchanged


def _drive_values(result: ExcitationIdentification) -> dict[tuple[str, str], Identified]:
    """Return the identified rotors and springs, by block and key of the drives file."""
    columns = result.problem.columns
    identified = _parameters(result)
    names = result.arm.names
    values = {}
    for there, kind, block, key in (
        (columns.rotors, "Ia", "transmission", "rotor_inertia"),
        (columns.springs, "k", "spring", "torque"),
    ):
        if not there:
            continue
        amounts = [identified.get(f"{kind}_{joint}", 0.0) for joint in range(1, len(names) + 1)]
        if min(amounts) < 0.0:
            worst = names[int(np.argmin(amounts))]
            raise IdentificationError(
                f"the {key} of {worst} was identified as {min(amounts):.3g}; accepted: >= 0"
            )
        written = [digits(amount, 12) for amount in amounts]
        values[block, key] = Identified(written, "identified", _origin(result))
    return values


def _parameters(result: ExcitationIdentification) -> dict[str, float]:
    """Return the parameters of the bodies in the files, by name."""
    numbers = result.consistency.parameters.tolist()
    return dict(zip(result.problem.columns.names, numbers, strict=True))


def _compensation(
    identified: Sequence[IdentifiedElement], names: Sequence[str], base: FolderBase
) -> dict[str, Identified]:
    """Return the controller's compensation for the identified friction of the elements with these names."""
    joints = len(base.robot.joint_names)
    # The friction that each motor works against; several viscous parts are one of their sum at the nominal speed.
    against = [[joint.element] for joint in identified[:joints]]
    for motor, shared in zip(base.turning.sums, identified[joints:], strict=True):
        against[motor].append(shared.element)
    coulomb = []
    viscous = []
    for elements, speed in zip(against, base.robot.max_velocity.tolist(), strict=True):
        coulomb.append(sum(0.5 * (law.tau_c.positive + law.tau_c.negative) for law in elements))
        viscous.append(
            sum(law.c2 * speed**law.alpha for law in elements) / speed ** elements[0].alpha
        )
    exponent = [elements[0].alpha for elements in against]
    source = "the identified friction of each joint"
    if base.turning.sums:
        source += f", and of {listed(names[joints:])} at the motors that turn with several joints"
    values = {"coulomb_torque": coulomb, "viscous_friction": viscous, "viscous_exponent": exponent}
    return {
        key: Identified([digits(value, 12) for value in joint_values], "derived", source)
        for key, joint_values in values.items()
    }


def _joints(result: ExcitationIdentification) -> dict[str, dict[str, float]]:
    """Return what is identified at each joint beside links and friction; of this project's arms the offset alone.

    Rotors and springs of another arm may be in a drives file, too: its URDF alone is held against bags with these.
    """
    values = _parameters(result)
    kinds = {"offset": "offset"} | (
        {} if result.robot.setup else {"rotor_inertia": "Ia", "spring": "k"}
    )
    joints = {}
    for number, name in enumerate(result.arm.names, 1):
        stated = {key: digits(values.get(f"{kind}_{number}", 0.0)) for key, kind in kinds.items()}
        stated = {key: value for key, value in stated.items() if value}
        if stated:
            joints[name] = stated
    return joints


_PARAMETERS_HEAD = """\
# Parameters identified from excitation runs, joint side, SI units; deviation: standard deviation, HAC.
# A base parameter is the combination of inertial parameters in `group`: m mass, mx .. mz first moments, Ixx .. Izz
# inertia about the origin of the link's joint, Ia rotor through its gear, k spring, offset of the torque; numbers are
# those of the joints from the base. The robot's own files in this folder hold what the simulation loads.
"""


def parameters_text(result: ExcitationIdentification) -> str:
    """Return the results of the runs beside friction as one YAML file for programs and for the record."""
    fitted = result.fitted
    bodies = result.consistency
    deviation = np.where(fitted.determined, fitted.deviation, np.nan)
    correlation = (fitted.covariance / np.outer(deviation, deviation)).tolist()
    content: dict[str, Any] = {
        "date": result.date.isoformat(timespec="seconds"),
        "versions": versions(),
        "bags": [
            {
                "path": str(bag.path),
                "use": use,
                "sha256": bag.sha256,
                "duration": digits(bag.duration),
            }
            for use, bag in result.bags
        ],
        "base_parameters": {
            parameter.name: {
                "unit": parameter.unit,
                "group": parameter.group,
                **_estimate(parameter.estimate),
                "consistent": digits(parameter.consistent),
            }
            for parameter in result.base
        },
        "friction": {
            name: {
                parameter: _estimate(estimate) for parameter, estimate in element.estimates.items()
            }
            for name, element in zip(result.arm.element_names, result.elements, strict=True)
        },
        "fit": {
            run.source.path.name: {"relative": digits(run.total_share)} for run in result.torques
        },
        "validation": {Path(check.source).name: _validation(check) for check in result.validations},
        "bodies": {
            "distance": digits(bodies.distance),
            "relative_error": digits(bodies.shares[1]),
        },
        "remarks": [
            *result.notes,
            *result.warnings,
            *bodies_warnings(result),
        ],
        "correlation": {
            "names": list(fitted.names),
            "matrix": [
                [None if math.isnan(share) else round(share, 3) for share in row]
                for row in correlation
            ],
        },
    }
    check_numbers(content, LARGEST)
    return in_unit(_PARAMETERS_HEAD + yaml_text(content), result.unit)


def _estimate(estimate: ParameterEstimate) -> dict[str, Any]:
    if not estimate.identifiable:
        return {"identifiable": False, "reason": estimate.reason}
    return {"value": digits(estimate.value), "deviation": digits(estimate.deviation)}


def _validation(check: Validation) -> dict[str, Any]:
    """Return the verdict, and the torque error of all joints by each prediction."""
    torques = {"by_files": check.torque, "simplest": check.simplest}
    shares = {
        name: {"relative": digits(run.total_share)}
        for name, run in torques.items()
        if run is not None
    }
    fitted = {} if check.fitted is None else {"relative": digits(check.fitted.total_share)}
    return {"confirmed": check.passed, **fitted, **shares}
