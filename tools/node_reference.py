"""Write the tables of parameters in docs/reference/parameters.md, from nodes that run.

    python -m tools.node_reference            # writes the page
    python -m tools.node_reference --json     # prints what the nodes have: parameters, topics, services

The nodes are started in this process, on a DDS domain of their own, and asked; nothing ticks. A page says where a table
belongs by two comments, `<!-- parameters of NODE -->` and `<!-- end -->`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

PAGE = Path(__file__).resolve().parent.parent / "docs/reference/parameters.md"
_PLACE = re.compile(r"(<!-- parameters of (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
_JOINT = re.compile(r"\bjoint_[1-6]\b")


class Parameter(NamedTuple):
    """What a node says of a parameter; `live`: whether it can be set while the node is active."""

    name: str
    default: Any
    accepted: str
    live: bool
    about: str


@dataclasses.dataclass(frozen=True)
class NodeReference:
    """What a node has: parameters; topics it publishes and listens to, and services, by name with their types."""

    name: str
    parameters: Sequence[Parameter]
    publishes: dict[str, str]
    listens: dict[str, str]
    services: dict[str, str]


def describe_nodes() -> list[NodeReference]:
    """Start simulation, controller and rig, and return what each has."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    from rx90_common.exchange.ros_start import prepare

    prepare()
    import rclpy

    from friction_bench.node.bench_node import BenchNode
    from rx90_common.exchange.ros_start import start_ros
    from rx90_emulator.composed_cell import CONTROLLER, SIMULATION, compose

    start_ros(["--ros-args", "--log-level", "warn"])
    members = [*compose({SIMULATION: [], CONTROLLER: []}), BenchNode()]
    try:
        return [_describe(member.node) for member in members]
    finally:
        for member in members:
            member.stop()
            member.node.destroy_node()
        rclpy.try_shutdown()


def _describe(node: Any) -> NodeReference:
    from rx90_common.exchange.parameters import OF_ROS

    names = [name for name in node.get_parameters_by_prefix("") if name not in OF_ROS]
    return NodeReference(
        node.get_name(),
        [_parameter(node, name) for name in names],
        {each.topic_name: _type(each.msg_type) for each in node.publishers},
        {each.topic_name: _type(each.msg_type) for each in node.subscriptions},
        {node.resolve_service_name(each.srv_name): _type(each.srv_type) for each in node.services},
    )


def _parameter(node: Any, name: str) -> Parameter:
    about = node.describe_parameter(name)
    held = node.get_parameter(name)
    ranges = [*about.integer_range, *about.floating_point_range]
    value = held.value if isinstance(held.value, bool | int | float | str) else list(held.value)
    accepted = f"{_number(ranges[0].from_value)} to {_number(ranges[0].to_value)}" if ranges else ""
    live = not about.read_only and node.set_parameters([held])[0].successful  # set to what it is
    return Parameter(name, value, accepted, live, about.description)


def _number(value: float) -> str:
    return f"{int(value):,}" if value == int(value) else f"{value:g}"


def _type(kind: Any) -> str:
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


def with_tables(page: str, nodes: Sequence[NodeReference]) -> str:
    """Return the text of a page with its tables written anew."""
    by_name = {node.name: node for node in nodes}
    before: list[str] = []  # what an earlier table has

    def written(place: re.Match[str]) -> str:
        return f"{place[1]}{_parameter_table(by_name[place[2]], before)}\n{place[4]}"

    return _PLACE.sub(written, page)


def _parameter_table(node: NodeReference, before: list[str]) -> str:
    rows: list[str] = []
    for each in node.parameters:
        name, about = (_JOINT.sub("<joint>", text) for text in (each.name, each.about))
        mark = "\\*" if each.live else ""
        row = f"| `{name}`{mark} | `{_text(each.default)}` | {each.accepted} | {_cell(about)} |"
        if row not in rows and row not in before:  # the same of each joint is one row
            rows.append(row)
    before += rows
    return "\n".join(["| parameter | default | accepted | meaning |", "|---|---|---|---|", *rows])


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if not isinstance(value, str) else value or "''"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<joint>", "`<joint>`")


def from_json(text: str) -> list[NodeReference]:
    """Return what `--json` has printed."""
    return [
        NodeReference(**{**node, "parameters": [Parameter(*each) for each in node["parameters"]]})
        for node in json.loads(text)
    ]


def main() -> int:
    """Write or print."""
    parser = argparse.ArgumentParser(
        description="Write the tables of parameters in docs/ from running nodes."
    )
    parser.add_argument(
        "--json", action="store_true", help="print what the nodes have, and write nothing"
    )
    options = parser.parse_args()
    nodes = describe_nodes()
    if options.json:
        print(json.dumps([dataclasses.asdict(node) for node in nodes]))
    else:
        PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), nodes), encoding="utf-8")
        print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
