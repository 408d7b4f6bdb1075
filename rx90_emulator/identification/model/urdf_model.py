"""The URDF of any robot as Pinocchio's model of the joints of interest, or a refusal in one line."""

from __future__ import annotations

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pinocchio as pin

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, plain, quoted

_TURNING = ("revolute", "continuous")
_STDERR = 2


def joint_model(urdf: Path, joints: Sequence[str] | None, *, massless: bool = False) -> Any:
    """Return Pinocchio's model of these joints; the others are held at zero.

    Args:
        urdf: the robot's description.
        joints: from base to tip; by default all movable joints.
        massless: whether joints that move no mass are accepted, because only kinematics are wanted.

    Raises:
        IdentificationError: for a file that cannot be read, and for joints that are not there, do not turn, follow
            another joint, or move no mass.
    """
    model, root = _whole(urdf)
    there = [str(name) for name in model.names][1:]
    wanted = there if joints is None else list(joints)
    for name in wanted:
        if name not in there:
            raise IdentificationError(f"{urdf}: no movable joint {quoted(name)}; there are {listed(there) or 'none'}")
    in_order = [name for name in there if name in wanted]
    if wanted != in_order:
        raise IdentificationError(f"{urdf}: joints {listed(wanted)}; accepted: from base to tip, {listed(in_order)}")
    if not wanted:
        raise IdentificationError(f"{urdf}: no movable joint; accepted: one or more")
    _check_turning(urdf, root, wanted, there)
    held = [model.getJointId(name) for name in there if name not in wanted]
    reduced = pin.buildReducedModel(model, held, pin.neutral(model)) if held else model
    if not massless:
        _check_mass(urdf, reduced)
    return reduced


def _whole(urdf: Path) -> tuple[Any, ET.Element]:
    lines: list[str] = []
    try:
        text = urdf.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", error)
        raise IdentificationError(f"{plain(urdf)}: cannot be read ({reason}); accepted: a URDF file") from error
    try:
        with _caught_stderr(lines):
            # Written anew: the XML parser of Pinocchio 2 takes no document type, and this one fetches nothing.
            root = ET.fromstring(text)
            return pin.buildModelFromXML(ET.tostring(root, encoding="unicode")), root
    except (ValueError, RuntimeError, ET.ParseError) as error:
        said = [line.removeprefix("Error:") for line in lines if line.startswith("Error:")]
        reason = " ".join((said[0] if said else str(error)).split()) or type(error).__name__
        raise IdentificationError(f"{urdf}: no URDF that Pinocchio can read ({reason})") from error


@contextmanager
def _caught_stderr(lines: list[str]) -> Iterator[None]:
    """Collect what is written to file descriptor 2, the only place where the parser below Pinocchio gives reasons."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        before = os.dup(_STDERR)
        os.dup2(file.fileno(), _STDERR)
        try:
            yield
        finally:
            os.dup2(before, _STDERR)
            os.close(before)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").splitlines()


def _check_turning(urdf: Path, root: ET.Element, wanted: Sequence[str], there: Sequence[str]) -> None:
    elements = {str(joint.get("name")): joint for joint in root.findall("joint")}
    bad = {}
    for name in there:
        mimic = elements[name].find("mimic")
        if elements[name].get("type") not in _TURNING:
            bad[name] = f"is {elements[name].get('type')}"
        elif mimic is not None:
            bad[name] = f"mimics {mimic.get('joint')}"
    for name in wanted:
        if name in bad:
            good = ", ".join(other for other in there if other not in bad)
            raise IdentificationError(
                f"{urdf}: joint {quoted(name)} {plain(bad[name])}; accepted: revolute and continuous joints with a "
                f"drive of their own, --joints {good.replace(',', '') or '(there are none)'}"
            )


def _check_mass(urdf: Path, model: Any) -> None:
    data = model.createData()
    pin.computeSubtreeMasses(model, data)
    for joint, name in list(enumerate(model.names))[1:]:
        if not data.mass[joint] > 0.0:
            raise IdentificationError(
                f"{urdf}: joint {quoted(str(name))} moves a mass of {data.mass[joint]:g} kg; "
                "accepted: links with <inertial>"
            )
