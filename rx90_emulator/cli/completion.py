"""Completion of all commands for a shell: options, choices, files, robots, plans and topics."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import shipped_robots
from rx90_emulator.cli.node import NODES
from rx90_emulator.cli.options import command_of, new_file, new_folder, place

SHELLS: Final = ("bash", "zsh", "fish")
_FILES = {"FILE", "BAG", "A", "B", "LOG", "TASK", "PATH", "REFERENCE", "DIR", "BASELINE"}
"""Placeholders of arguments that are files or folders; arguments of the type Path need none of them."""


def completion(shell: str, executables: Mapping[str, str]) -> str:
    """Return the script that a shell reads.

    Args:
        shell: one of SHELLS.
        executables: where the functions of each are, by its name.
    """
    import shtab

    parts: list[str] = []
    for name, where in sorted(executables.items()):
        parser, _ = command_of(name, where)
        if name in NODES:  # whose arguments ROS reads
            ros = parser.add_argument_group("ros")
            ros.add_argument("--ros-args", action="store_true", help="what follows is for ROS")
            ros.add_argument("--params-file", metavar="FILE", help="parameter file")
            ros.add_argument("-p", "--param", metavar="NAME:=VALUE", help="parameter")
            ros.add_argument("-r", "--remap", metavar="FROM:=TO", help="other name of a topic, a service or the node")
        parser.description = None
        for action in _actions(parser):
            if (found := _completed_by(action, shtab.FILE, shtab.DIRECTORY)) is not None:
                action.complete = found  # type: ignore[attr-defined]  # where shtab looks for it
        parts.append(shtab.complete(parser, shell=shell, preamble="" if parts else _words_or_files(shell)))
    return "\n".join(parts)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a command and of its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
        else:
            yield action


def _completed_by(action: argparse.Action, file: Any, folder: Any) -> Any:
    """Return what completes an argument, None where nothing but its choices does."""
    if action.choices is not None or action.nargs == 0:
        return None
    if action.dest in _WORDS:
        name = f"_rx90_{action.dest}"
        return {"bash": name, "zsh": name, "fish": f"({name})"}
    if action.type is new_folder:
        return folder
    if action.type in (Path, place, new_file) or action.metavar in _FILES:
        return file
    return None


_WORDS: Final = ("robot", "plan", "topics")
"""Arguments that words complete, by the attribute of the options that they become."""


def _words_or_files(shell: str) -> str:
    """Return functions of the shell that complete the arguments in _WORDS."""
    plans = sorted(f"sweep/{path.name}" for path in config_path("sweep").glob("*.yaml"))
    words = {"robot": shipped_robots(), "plan": plans, "topics": SUITE_TOPICS}
    files = {
        "robot": {"bash": "compgen -d", "zsh": "_files -/", "fish": "__fish_complete_directories"},
        "plan": {"bash": "compgen -f", "zsh": "_files", "fish": "__fish_complete_path (commandline -ct)"},
    }
    text = ""
    for name in _WORDS:
        listed = " ".join(words[name])
        own = files.get(name, {}).get(shell)
        if shell == "bash":
            rest = f'; {own} -- "$1"' if own else ""
            text += f"_rx90_{name}() {{ compgen -W '{listed}' -- \"$1\"{rest}; }}\n"
        elif shell == "fish":
            rest = f"; {own}" if own else ""
            text += f"function _rx90_{name}; string split ' ' '{listed}'{rest}; end\n"
        else:
            rest = f" 'file:file:{own}'" if own else ""
            text += f"_rx90_{name}() {{ _alternative 'name:name:({listed})'{rest} }}\n"
    return text
