"""A URDF or a tool file that is not a usable arm is refused in one line that names the culprit."""

import re
import resource
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.description.joint_model import joint_model
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles

LINK_5 = '<mass value="1.2"/>'
INERTIA_5 = 'ixx="0.0022" ixy="0" ixz="0" iyy="0.0023" iyz="0" izz="0.0008"'
LIMIT_5 = 'lower="-1.8325957145940461" upper="2.0943951023931953" velocity="5.585053606381854" effort="43.5"'
JOINT_5 = '<joint name="joint_5" type="revolute">'
XACRO = '<link name="flange"/><xacro:arm xmlns:xacro="http://ros.org/wiki/xacro"/>'
AXIS_1 = '<child link="link_1"/>\n    <axis xyz="0 0 1"/>'

CASES = {
    "broken XML": ("</robot>", "", "not well-formed XML"),
    "xacro": ('<link name="flange"/>', XACRO, "expand it with xacro"),
    "prismatic": (JOINT_5, '<joint name="joint_5" type="prismatic">', "'joint_5' type is 'prismatic'"),
    "side branch": ('<parent link="link_5"/>', '<parent link="link_4"/>', "on a side branch"),
    "two roots": ('<parent link="base_link"/>\n    <child link="link_1"/>', '<parent link="flange"/>'
                  '<child link="link_1"/>', "joint 'joint_1' hangs at no link|joint 'flange_fixed' hangs"),
    "unknown parent": ('<parent link="link_5"/>', '<parent link="link_7"/>', r"link_7\] of joint \[joint_6\] not"),
    "name twice": ('<link name="flange"/>', '<link name="link_4"/>', "link 'link_4' is not unique"),
    "name that turns the text": ('<robot name="rx90b"', '<robot name="a\u202eb"', "'robot' is 'a"),
    "zero mass": (LINK_5, '<mass value="0"/>', "'joint_5' moves no mass"),
    "not definite by products": (INERTIA_5, INERTIA_5.replace('ixy="0"', 'ixy="0.003"'), "positive definite"),
    "triangle": (INERTIA_5, INERTIA_5.replace("0.0008", "0.0080"), "any two add up"),
    "limits crossed": (LIMIT_5, LIMIT_5.replace('"-1.83', '"3.83'), "'joint_5' limit lower is 3.83"),
    "axis zero": (AXIS_1, AXIS_1.replace("0 0 1", "0 0 0"), "'joint_1': axis is 0 0 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_bad_urdf_is_refused_by_file_element_and_value(case: str, shipped_files: RobotFiles, tmp_path: Path) -> None:
    """One fault in the URDF gives one line with the file, the element, the value and what is accepted."""
    old, new, expected = CASES[case]
    text = shipped_files.urdf.read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "bad.urdf"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError) as refusal:
        load_robot(file, shipped_files.tool)
    message = str(refusal.value)
    assert re.search(expected, message), message
    assert message.startswith(str(file))
    assert "\n" not in message


def test_what_does_not_move_may_have_any_inertia(shipped_files: RobotFiles, tmp_path: Path) -> None:
    """A wrong inertia of a link that is fixed to the base, as a mobile robot's antenna has, changes nothing."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    antenna = (
        '<link name="antenna"><inertial><mass value="0.001"/><inertia ixx="2e-8" iyy="3e-8" izz="4e-8" ixy="6e-8" '
        'ixz="0" iyz="0"/></inertial></link><joint name="up" type="fixed"><parent link="{}"/><child link="antenna"/>'
        "</joint></robot>"
    )
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text.replace("</robot>", antenna.format("base_link")), encoding="utf-8")
    for got, want in zip(load_robot(urdf).chain, load_robot(shipped_files.urdf).chain, strict=True):
        assert np.array_equal(got, want)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00<", b"no xml at all"])
def test_a_file_that_is_no_urdf_is_refused(content: bytes | None, tmp_path: Path) -> None:
    """A missing, empty, binary or foreign file gives one line that names it."""
    file = tmp_path / "foreign.urdf"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"foreign\.urdf: (cannot be read|not well-formed)") as refusal:
        load_robot(file)
    assert "\n" not in str(refusal.value)


def test_a_tool_that_cannot_be_is_refused(shipped_files: RobotFiles, edited_yaml: Callable[..., Path]) -> None:
    """Moments of inertia that no body has, and a shape that ends before it begins: file, key and value in one line."""
    for place, value, said in (
        (("inertial", "inertia"), [0.01, 0.01, 0.05, 0, 0, 0], r"inertial\.inertia is .*any two"),
        (("visual", "cylinders", "body"), [0.2, 0.1, 0.04], r"visual\.cylinders\.body is"),
    ):
        with pytest.raises(ConfigError, match=rf"tool\.yaml.*{said}"):
            load_robot(shipped_files.urdf, edited_yaml(shipped_files.tool, place, value))


def test_a_tool_needs_a_place_of_its_own(shipped_files: RobotFiles, tmp_path: Path) -> None:
    """Without a link tool0, or with a link tool already there, the tool is refused."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    file = tmp_path / "other.urdf"
    file.write_text(text.replace('"tool0"', '"hand"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="link 'tool0' is None"):
        load_robot(file, shipped_files.tool)
    assert load_robot(file).tcp_frame == "hand"
    file.write_text(text.replace('"flange"', '"tool"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="a link is 'tool'"):
        load_robot(file, shipped_files.tool)


ENTITIES = {
    "external DTD": ('<!DOCTYPE robot SYSTEM "{server}/robot.dtd">', ""),
    "external parameter entity": ('<!DOCTYPE robot [<!ENTITY % all SYSTEM "{server}/all.dtd"> %all;]>', ""),
    "entity from the network": ('<!DOCTYPE robot [<!ENTITY far SYSTEM "{server}/far">]>', "&far;"),
    "entity from a file": ('<!DOCTYPE robot [<!ENTITY near SYSTEM "file://{file}">]>', "&near;"),
    "entities of entities": (
        '<!DOCTYPE robot [<!ENTITY e0 "ha">'
        + "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
        + "]>",
        "&e9;",
    ),
}


@pytest.mark.parametrize("case", ENTITIES)
def test_what_a_urdf_refers_to_is_never_fetched(case: str, shipped_files: RobotFiles, tmp_path: Path) -> None:
    """A DTD or an entity from elsewhere is neither asked for nor read, and entities do not fill the memory."""
    secret = tmp_path / "secret"
    secret.write_text("secret")
    with socket.create_server(("127.0.0.1", 0)) as server:
        doctype, reference = ENTITIES[case]
        doctype = doctype.replace("{server}", f"http://127.0.0.1:{server.getsockname()[1]}").replace(
            "{file}", str(secret)
        )
        file = tmp_path / "arm.urdf"
        text = shipped_files.urdf.read_text(encoding="utf-8").replace("<robot", f"{doctype}\n<robot", 1)
        file.write_text(text.replace('<link name="flange"/>', f'<link name="flange">{reference}</link>'))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for read in (load_robot, lambda urdf: joint_model(urdf, None)):
            if reference:
                with pytest.raises(Rx90Error, match=r"arm\.urdf: no") as refusal:
                    read(file)
                assert "secret" not in str(refusal.value).replace(str(tmp_path), "")
            else:
                read(file)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + (200 << 10)  # KiB
        server.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            server.accept()


@pytest.mark.parametrize(("key", "value"), [("friction", "-0.39"), ("damping", "nan")])
def test_dynamics_do_not_count(tmp_path: Path, shipped_files: RobotFiles, key: str, value: str) -> None:
    """Also values of <dynamics> that Pinocchio would refuse: friction is in the friction file."""
    text = shipped_files.urdf.read_text(encoding="utf-8")
    file = tmp_path / "arm.urdf"
    file.write_text(text.replace("<axis", f'<dynamics {key}="{value}"/><axis', 3), encoding="utf-8")
    assert joint_model(file, None).nv == 6
    assert load_robot(file).urdf == load_robot(shipped_files.urdf).urdf


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<link name="flange"/>', '<link name="a&#10;b"/>', r"'link' is 'a\nb'; accepted: one line of printable"),
        ("</robot>", f"</robot>{' ' * (4 << 20)}", "larger than 4,194,304 bytes"),
    ],
)
def test_every_reader_of_a_urdf_refuses_names_of_lines_and_sizes(
    old: str, new: str, said: str, tmp_path: Path, shipped_files: RobotFiles
) -> None:
    """Also that of foreign robots, whose names go into files and pages."""
    file = tmp_path / "arm.urdf"
    file.write_text(shipped_files.urdf.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    for read in (load_robot, lambda urdf: joint_model(urdf, None)):
        with pytest.raises(Rx90Error) as refusal:
            read(file)
        assert said in str(refusal.value)
