"""The reference pages say what the nodes, the commands and the Python API have, and nothing else."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from processes import Processes, on_own_domain

from rx90_emulator.cli.frame import NODES, VERBS
from tools.node_reference import PAGE, NodeReference, from_json, with_tables

REFERENCE = Path(__file__).resolve().parents[2] / "docs/reference"
OF_EVERY_NODE = re.compile(r"/parameter_events|.*/(\w*parameter\w*|get_type_description|get_\w*(state|transition)\w*)")
ON_DEMAND = {
    "/tf": "tf2_msgs/TFMessage",
    "/tf_static": "tf2_msgs/TFMessage",
    "/joint_commands": "sensor_msgs/JointState",  # with command_interface joint
    "/measured_joint_states": "sensor_msgs/JointState",
}


@pytest.fixture(scope="module")
def nodes(needs_action: None, tmp_path_factory: pytest.TempPathFactory) -> Sequence[NodeReference]:  # noqa: ARG001 - it must be there
    with pytest.MonkeyPatch.context() as monkeypatch, on_own_domain(monkeypatch, tmp_path_factory.mktemp("ros")):
        asked = Processes().run(sys.executable, "-m", "tools.node_reference", "--json", timeout=400.0)
    assert asked.returncode == 0, asked.stderr
    return from_json(asked.stdout)


def documented(heading: str) -> dict[str, str]:
    """Return names and types from the tables of topics.md whose first column is `heading`; names are absolute."""
    text = (REFERENCE / "topics.md").read_text(encoding="utf-8")
    tables = re.findall(rf"^\| {heading} \|.*\n\|[-|]+\n((?:\|.*\n)+)", text, re.MULTILINE)
    rows = [row.split("|")[1:3] for table in tables for row in table.splitlines()]
    return {f"/{name.lstrip('/')}": kind.strip() for names, kind in rows for name in re.findall(r"`([^`]+)`", names)}


@pytest.mark.ros
def test_parameters_are_those_of_the_nodes(nodes: Sequence[NodeReference]) -> None:
    """Name, default, range and meaning of every parameter are what running nodes declare."""
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_tables(text, nodes), "run python -m tools.node_reference"
    assert {node.name for node in nodes} == set(re.findall(r"<!-- parameters of (\w+) -->", text))


@pytest.mark.ros
def test_topics_are_those_of_the_nodes(nodes: Sequence[NodeReference]) -> None:
    """Every topic of the nodes stands in topics.md with its type, and no other; those of the action in action.md."""
    action = (REFERENCE.parent / "howto/action.md").read_text(encoding="utf-8")
    found: dict[str, str] = {}
    for node in nodes:
        for name, kind in {**node.publishes, **node.listens}.items():
            if kind.startswith("control_msgs/"):
                assert name.rpartition("/")[2] in action, name
            elif not re.fullmatch(r"/parameter_events", name):
                found[name] = kind
    assert documented("topic") == {**found, **ON_DEMAND}


@pytest.mark.ros
def test_services_are_those_of_the_nodes(nodes: Sequence[NodeReference]) -> None:
    """Every service that is not every node's stands in topics.md with its type, and no other."""
    found = {
        name: kind
        for node in nodes
        for name, kind in node.services.items()
        if not OF_EVERY_NODE.fullmatch(name)
        and not kind.startswith(("control_msgs/", "controller_manager_msgs/", "lifecycle_msgs/"))
    }
    services = documented("service")
    assert services.pop("/change_state") == "lifecycle_msgs"
    assert services == found


def test_every_command_has_its_place() -> None:
    """Each node and verb stands in the table of commands.md, and the place of their options below it."""
    text = (REFERENCE / "commands.md").read_text(encoding="utf-8")
    listed = {
        name
        for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
        for name in re.findall(r"`(?:rx90 )?(\w+)", row)
    }
    assert {*NODES, *VERBS} <= listed
    assert text.endswith("```{commands}\n```\n")
