"""The parser of each command, by its name, as `sphinx-argparse` asks for them."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable
from functools import partial
from importlib import import_module

from rx90_emulator.cli.frame import EXECUTABLES
from rx90_emulator.cli.options import CommandParser


def _parser(name: str) -> ArgumentParser:
    command = import_module(EXECUTABLES[name])
    parser = CommandParser(prog=name, description=command.__doc__)
    command.add_arguments(parser)
    return parser


def __getattr__(name: str) -> Callable[[], ArgumentParser]:
    """Return what makes the parser of a command."""
    if name not in EXECUTABLES:
        raise AttributeError(name)
    return partial(_parser, name)
