"""Print the completion of `rx90` and the nodes for a shell: verbs, options, choices, files, robots, plans and topics.

To turn it on, put into ~/.bashrc or ~/.zshrc: eval "$(rx90 completion bash)", or zsh; that of zsh behind compinit.
For fish: rx90 completion fish | source, in config.fish.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import shipped_robots
from rx90_emulator.cli.frame import VERBS
from rx90_emulator.cli.node import NODES
from rx90_emulator.cli.options import command_of, module_of, new_file, new_folder, place

_SHELLS: Final = ("bash", "zsh", "fish")
_FILES = {"FILE", "BAG", "A", "B", "LOG", "TASK", "PATH", "REFERENCE", "DIR", "BASELINE"}
"""Placeholders of arguments that are files or folders; arguments of the type Path need none of them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("shell", choices=_SHELLS)


def main(options: argparse.Namespace) -> None:
    """Print the script that a shell reads."""
    import shtab

    preamble = _words_or_files(options.shell)
    for parser in (_rx90(), *map(_node, NODES)):
        for action in _actions(parser):
            completer = _completed_by(action, shtab.FILE, shtab.DIRECTORY)
            if completer is not None:
                action.complete = completer  # type: ignore[attr-defined]  # where shtab looks for it
        print(shtab.complete(parser, shell=options.shell, preamble=preamble))
        preamble = ""


def _rx90() -> argparse.ArgumentParser:
    """Return the parser of `rx90` with those of all verbs, which otherwise are made when they are asked for."""
    parser = argparse.ArgumentParser(prog="rx90")
    verbs = parser.add_subparsers()
    for verb in VERBS:
        module = module_of(f"rx90 {verb}")
        summary = (inspect.getdoc(module) or "").split("\n")[0]
        module.add_arguments(verbs.add_parser(verb, help=summary, description=summary))
    return parser


def _node(name: str) -> argparse.ArgumentParser:
    """Return the parser of a node, with the arguments that ROS reads."""
    parser, _ = command_of(name)
    parser.description = None
    ros = parser.add_argument_group("ros")
    ros.add_argument("--ros-args", action="store_true", help="what follows is for ROS")
    ros.add_argument("--params-file", metavar="FILE", help="parameter file")
    ros.add_argument("-p", "--param", metavar="NAME:=VALUE", help="parameter")
    ros.add_argument(
        "-r", "--remap", metavar="FROM:=TO", help="other name of a topic, a service or the node"
    )
    return parser


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
        "plan": {
            "bash": "compgen -f",
            "zsh": "_files",
            "fish": "__fish_complete_path (commandline -ct)",
        },
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
