"""Print the completion of `rx90` and the nodes for a shell: verbs, options, choices and files.

To turn it on, put into ~/.bashrc or ~/.zshrc: eval "$(rx90 completion bash)", or zsh; that of zsh behind compinit.
For fish: rx90 completion fish | source, in config.fish.
"""

from __future__ import annotations

import argparse
import inspect
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path

from rx90_emulator.cli.frame import VERBS
from rx90_emulator.cli.node import NODES
from rx90_emulator.cli.options import (
    add_options,
    command_of,
    module_of,
    new_file,
    new_folder,
    place,
)

_SHELLS = ("bash", "zsh", "fish")
_FILES = {
    "FILE",
    "ROBOT",
    "PLAN",
    "BAG",
    "A",
    "B",
    "LOG",
    "TASK",
    "PATH",
}
"""Placeholders of arguments that are files or folders; arguments of the type Path need none of them."""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("shell", choices=_SHELLS)


def main(options: Namespace) -> None:
    """Print the script that a shell reads."""
    import shtab

    for parser in (_rx90(), *map(_node, NODES)):
        for action in _actions(parser):
            if action.type is new_folder:
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]  # where shtab looks for it
            elif action.type in (Path, place, new_file) or action.metavar in _FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        print(shtab.complete(parser, shell=options.shell))


def _rx90() -> ArgumentParser:
    """Return the parser of `rx90` with those of all verbs, which otherwise are made when they are asked for."""
    parser = ArgumentParser(prog="rx90")
    verbs = parser.add_subparsers()
    for verb in VERBS:
        module = module_of(f"rx90 {verb}")
        summary = (inspect.getdoc(module) or "").split("\n")[0]
        add_options(verbs.add_parser(verb, help=summary, description=summary), module)
    return parser


def _node(name: str) -> ArgumentParser:
    """Return the parser of a node, with the arguments that ROS reads."""
    parser, _ = command_of(name)
    parser.description = None
    ros = parser.add_argument_group("ros")
    ros.add_argument("--ros-args", action="store_true", help="what follows is for ROS")
    ros.add_argument("--params-file", metavar="FILE", help="parameter file")
    return parser


def _actions(parser: ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a command and of its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
        else:
            yield action
