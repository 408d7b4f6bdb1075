"""Count the habits that make code hard to read, and hold the counts to those written down: they may only fall.

    python -m tools.habits                 # exit code 1 if a count is above the one in habits.json, or below it and
                                           # not yet written down
    python -m tools.habits --list HABIT    # every place of it
    python -m tools.habits --write         # write the lower counts down, in tools/habits.json

Ruff finds what it has a rule for (many arguments, private members, exec); a syntax tree tells the rest.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tools.sizes import ROOMS, ROOT, files

COUNTS = ROOT / "tools/habits.json"
MOST_ARGUMENTS = 7
RUFF_RULES = {
    f"more than {MOST_ARGUMENTS} arguments": "PLR0913",
    "private member of another object": "SLF001",
    "exec": "S102",
}
Place = tuple[str, int]
"""A file and a line of it."""


def find_habits() -> dict[str, list[Place]]:
    """Return the places of each habit in the product's code."""
    names = files(*(f"{room}/**/*.py" for room in ROOMS))
    places = {habit: _find_by_ruff(rule) for habit, rule in RUFF_RULES.items()}
    places |= {habit: [] for habit in (*SYNTAX_HABITS, "fmt: skip")}
    for name in names:
        source = (ROOT / name).read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)):
            for habit, shows in SYNTAX_HABITS.items():
                if shows(node):
                    places[habit].append((name, node.lineno))
        places["fmt: skip"] += [(name, line) for line in _lines_with_fmt_skip(source)]
    return places


def _find_by_ruff(rule: str) -> list[Place]:
    settings = ("--isolated", "--ignore-noqa", "--config", f"lint.pylint.max-args={MOST_ARGUMENTS}")
    output = ("--select", rule, "--output-format", "json", "--exit-zero")
    command = [sys.executable, "-m", "ruff", "check", *settings, *output, *ROOMS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [
        (str(Path(finding["filename"]).relative_to(ROOT)), finding["location"]["row"])
        for finding in json.loads(done.stdout)
    ]


def _lines_with_fmt_skip(source: str) -> Iterator[int]:
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and "fmt: skip" in token.string:
            yield token.start[0]


def joins_assignments(node: ast.AST) -> bool:
    """Return whether a statement assigns several values to several names at once; an exchange of values is none."""
    if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple)):
        return False
    if not isinstance(node.targets[0], ast.Tuple):
        return False
    targets = {ast.unparse(target) for target in node.targets[0].elts}
    used = {ast.unparse(part) for part in ast.walk(node.value) if isinstance(part, ast.expr)}
    return not targets & used


def unpacks_generator(node: ast.AST) -> bool:
    """Return whether the items of a generator or a list made on the spot become names."""
    if not (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)):
        return False
    is_map = isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "map"
    return is_map or isinstance(node.value, ast.GeneratorExp | ast.ListComp)


def multiplies_by_truth(node: ast.AST) -> bool:
    """Return whether something is multiplied by a truth value, where an `if` would say what is meant."""
    if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)):
        return False
    sides = (node.left, node.right)
    if any(isinstance(side, ast.Call) and ast.unparse(side.func) == "bool" for side in sides):
        return True
    has_text = any(isinstance(side, ast.JoinedStr | ast.List) or _is_text(side) for side in sides)
    return has_text and any(
        isinstance(side, ast.Compare | ast.BoolOp | ast.UnaryOp) for side in sides
    )


def builds_attribute_name(node: ast.AST) -> bool:
    """Return whether an attribute is read or set by a name that is put together from pieces."""
    if not (
        isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "setattr", "hasattr")
    ):
        return False
    return len(node.args) > 1 and isinstance(node.args[1], ast.JoinedStr | ast.BinOp)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


SYNTAX_HABITS = {
    "several assignments in one": joins_assignments,
    "unpacked generator": unpacks_generator,
    "multiplied by a truth value": multiplies_by_truth,
    "attribute by a built name": builds_attribute_name,
}


def main() -> int:
    """Compare the counts with those written down."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", metavar="HABIT", help="print its places")
    parser.add_argument(
        "--write", action="store_true", help="write lower counts down; higher ones stay refused"
    )
    options = parser.parse_args()
    places = find_habits()
    if options.list is not None:
        if options.list not in places:
            parser.error(f"--list {options.list!r}; accepted: {', '.join(map(repr, places))}")
        for name, line in places[options.list]:
            print(f"{name}:{line}")
        return 0
    allowed = json.loads(COUNTS.read_text(encoding="utf-8")) if COUNTS.exists() else {}
    counts = {habit: len(found) for habit, found in places.items()}
    higher = [habit for habit, count in counts.items() if count > allowed.get(habit, count)]
    for habit in higher:
        print(
            f"{habit}: {counts[habit]} places, {allowed[habit]} allowed; python -m tools.habits --list {habit!r}"
        )
    if options.write and not higher:
        COUNTS.write_text(json.dumps(counts, indent=2) + "\n", encoding="utf-8")
        return 0
    lower = [
        habit
        for habit, count in counts.items()
        if count < allowed.get(habit, 0) or habit not in allowed
    ]
    for habit in lower:
        print(
            f"{habit}: {counts[habit]} places, {allowed.get(habit, 'none')} written down; run with --write"
        )
    return int(bool(higher or lower))


if __name__ == "__main__":
    sys.exit(main())
