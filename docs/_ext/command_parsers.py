"""The parser of each node and each verb of `rx90`, by its name, as `sphinx-argparse` asks for them.

On the page of the commands, `{commands}` stands for a section of each with its options.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, _SubParsersAction
from collections.abc import Callable, Iterator
from functools import partial

from sphinx.application import Sphinx

from rx90_emulator.cli.frame import NODES, VERBS
from rx90_emulator.cli.options import command_of

_SECTION = """## {title}

```{{eval-rst}}
.. argparse::
   :module: command_parsers
   :func: {name}
   :prog: {title}
   :nodefault:
```
"""


def _parser(name: str) -> ArgumentParser:
    parser, _ = command_of(name if name in NODES else f"rx90 {name}")
    for each in _with_verbs(parser):
        each.description, each.epilog = _as_written(each.description), _as_written(each.epilog)
    return parser


def _with_verbs(parser: ArgumentParser) -> Iterator[ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, _SubParsersAction):
            for verb in action.choices.values():
                yield from _with_verbs(verb)


def _as_written(text: str | None) -> str | None:
    """Return a text with its indented lines as code, as a terminal shows them."""
    if text is None:
        return None
    return re.sub(
        r"(?:^ +\S.*\n?)+", lambda lines: f"\n::\n\n{lines[0]}\n", text, flags=re.MULTILINE
    )


def __getattr__(name: str) -> Callable[[], ArgumentParser]:
    """Return what makes the parser of a command."""
    if name not in (*NODES, *VERBS):
        raise AttributeError(name)
    return partial(_parser, name)


def sections() -> str:
    """Return a section for each node and verb, as Markdown."""
    titles = {name: name if name in NODES else f"rx90 {name}" for name in (*NODES, *VERBS)}
    return "\n".join(_SECTION.format(name=name, title=title) for name, title in titles.items())


def _write_sections(_: Sphinx, __: str, source: list[str]) -> None:
    source[0] = source[0].replace("```{commands}\n```", sections())


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the sections before a page is read."""
    app.connect("source-read", _write_sections)
    return {"parallel_read_safe": True}
