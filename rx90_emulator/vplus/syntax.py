"""Lines of V+ as trees: what the grammar (grammar.lark) finds in a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from lark import Lark, Token, Transformer, Tree
from lark.exceptions import LarkError, UnexpectedInput

NAME_LENGTH = 15
"""Characters of a name that count."""
LONGEST_LINE = 255
"""Characters; a longer line is refused."""


@dataclass(frozen=True)
class Number:
    """A constant."""

    value: float


@dataclass(frozen=True)
class Text:
    """A string in quotes."""

    value: str


@dataclass(frozen=True)
class Reference:
    """A variable, an element of an array, or a whole array.

    Attributes:
        name: in lower case, cut to the length that counts.
        index: None for a plain variable; one expression for each dimension, None where it is left out.
    """

    name: str
    index: tuple[Expression | None, ...] | None = None


@dataclass(frozen=True)
class Function:
    """A function, or a program in a CALL, with its arguments; None where one is left out."""

    name: str
    arguments: tuple[Expression | Format | None, ...]


@dataclass(frozen=True)
class Prefixed:
    """An operator before its operand."""

    operator: str
    operand: Expression


@dataclass(frozen=True)
class Compound:
    """Locations joined by colons."""

    parts: tuple[Expression, ...]


@dataclass(frozen=True)
class Operation:
    """Operands with operators between them, as they stand in the line; how they bind is a reading."""

    operands: tuple[Expression, ...]
    operators: tuple[str, ...]


@dataclass(frozen=True)
class Format:
    """A format of TYPE or $ENCODE, such as /F8.2."""

    text: str


Expression: TypeAlias = Number | Text | Reference | Function | Prefixed | Compound | Operation
Argument: TypeAlias = Expression | Format | None


@dataclass(frozen=True)
class Line:
    """An instruction.

    Attributes:
        word: in upper case: its first word, `=` for an assignment.
        arguments: in their order, None where one is left out.
        value: what stands behind an equals sign.
        modifiers: such as ALWAYS.
        unit: what stands in brackets behind the first word, of instructions that have a unit there.
    """

    word: str
    arguments: tuple[Argument, ...] = ()
    value: Expression | None = None
    modifiers: tuple[str, ...] = ()
    unit: tuple[Argument, ...] = ()


def plain_name(name: str) -> str:
    """Return a name as it counts."""
    return name.lower()[:NAME_LENGTH]


def nodes(tree: object) -> Iterator[Any]:
    """Yield a tree and all trees in it."""
    if isinstance(tree, tuple):
        for part in tree:
            yield from nodes(part)
    elif is_dataclass(tree):
        yield tree
        for field in fields(tree):
            yield from nodes(tree.__dict__[field.name])


_BASES = {"B": 2, "O": 8, "H": 16}


class _Builder(Transformer[Line]):
    """Makes the trees, rule by rule of the grammar."""

    def number(self, parts: list[Token]) -> Number:
        text = str(parts[0])
        if text[0] == "'":
            return Number(float(ord(text[1])))
        if text[0] == "^":
            return Number(float(int(text[2:], _BASES[text[1].upper()])))
        return Number(float(text))

    def text(self, parts: list[Token]) -> Text:
        return Text(str(parts[0])[1:-1])

    def format(self, parts: list[Token]) -> Format:
        return Format(str(parts[0])[1:].upper())

    def index(self, parts: list[Any]) -> tuple[Any, ...]:
        return tuple(parts)

    def reference(self, parts: list[Any]) -> Reference:
        return Reference(plain_name(parts[0]), parts[1])

    def omitted(self, parts: list[Any]) -> Any:
        return parts[0]

    def arguments(self, parts: list[Any]) -> tuple[Any, ...]:
        return tuple(parts)

    def leading_gap(self, parts: list[Any]) -> tuple[Any, ...]:
        return (None, *parts)

    parts = arguments
    late_parts = leading_gap

    def function(self, parts: list[Any]) -> Function:
        reference, arguments = parts
        return Function(reference.name, arguments or ())

    def prefixed(self, parts: list[Any]) -> Prefixed:
        return Prefixed(parts[0].upper(), parts[1])

    def compound(self, parts: list[Any]) -> Any:
        return parts[0] if len(parts) == 1 else Compound(tuple(parts))

    def expression(self, parts: list[Any]) -> Any:
        if len(parts) == 1:
            return parts[0]
        return Operation(tuple(parts[::2]), tuple(part.upper() for part in parts[1::2]))

    def modifier(self, parts: list[Token]) -> str:
        return parts[0].upper()

    def assignment(self, parts: list[Any]) -> Line:
        return Line("=", (parts[0],), parts[1])

    def plain_command(self, parts: list[Any]) -> Line:
        return Line(parts[0].upper(), modifiers=tuple(parts[1:]))

    def command(self, parts: list[Any]) -> Line:
        return Line(parts[0].upper(), parts[1], modifiers=tuple(parts[2:]))

    def setting(self, parts: list[Any]) -> Line:
        return Line(parts[0].upper(), parts[1], parts[2])

    def unit_command(self, parts: list[Any]) -> Line:
        word, unit, arguments = parts[:3]
        return Line(word.upper(), arguments or (), modifiers=tuple(parts[3:]), unit=unit or ())

    def declaration(self, parts: list[Any]) -> Line:
        return Line(parts[0].upper(), tuple(parts[2:]))


def _control_line(tree: Tree) -> Line:
    """Return the instruction of control that a rule of the grammar is named after."""
    word = str(tree.data).upper().strip("_").replace("_", " ")
    kept = [part for part in tree.children if not (isinstance(part, Token) and part.type == "LAST_COLON")]
    arguments: list[Any] = [Number(float(part)) if isinstance(part, Token) else part for part in kept]
    return Line(word, tuple(arguments))


@cache
def _parser() -> Lark:
    grammar = Path(__file__).with_name("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", start="line", maybe_placeholders=True, transformer=_Builder())


def parse_line(text: str) -> Line:
    """Return the instruction in a line that has neither label nor comment.

    Raises:
        SyntaxError: saying what the line has and where.
    """
    if len(text) > LONGEST_LINE:
        raise SyntaxError(f"a line of {len(text)} characters; accepted: up to {LONGEST_LINE}")
    try:
        parsed = _parser().parse(text)
    except UnexpectedInput as error:
        ends = "$END" in str(error).partition("\n")[0]
        rest = "" if ends else text[error.column - 1 :][:20]
        raise SyntaxError(f"{rest!r} is not expected" if rest.strip() else "the line ends too early") from None
    except (LarkError, RecursionError) as error:
        raise SyntaxError(f"not understood ({type(error).__name__})") from None
    return parsed if isinstance(parsed, Line) else _control_line(parsed)
