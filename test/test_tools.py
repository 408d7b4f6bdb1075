"""The tools that count: sizes by Python's tokenizer, and the habits whose counts may only fall."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import pytest

from tools import habits
from tools.sizes import count_options, measure

SOURCE = '''"""A docstring
of two lines."""

import os  # a comment


def double(number: int) -> int:
    """Another one."""
    return (
        2 * number
    )
'''


def test_tokens_are_those_of_the_code_alone() -> None:
    """Of a sample counted by hand: import 2, signature 10, return 6 tokens; 5 lines of code of 11."""
    size = measure(SOURCE)
    assert size.tokens == 2 + 10 + 6  # `import os`, the signature, and what it returns
    assert (size.code_lines, size.lines) == (5, 11)


def test_options_are_counted_wherever_they_are_declared() -> None:
    """A name over two lines and one that is put together count; an argument without a dash does not."""
    source = (
        'p.add_argument(\n "--a")\np.add_argument(f"--{x}")\np.add_argument("-o", "--out")\np.add_argument("file")\n'
    )
    assert count_options(source) == 3


@pytest.mark.parametrize(
    ("source", "habit"),
    [
        ("first, second = 1, 2", "several assignments in one"),
        ("self.a, self.b = x, None", "several assignments in one"),
        ("a, b = (f(x) for x in row)", "unpacked generator"),
        ("a, b = map(float, row)", "unpacked generator"),
        ("text = '; note' * bool(note)", "multiplied by a truth value"),
        ("text = f'[{unit}]' * (unit != '')", "multiplied by a truth value"),
        ("getattr(part, f'stribeck_{side}')", "attribute by a built name"),
        ("a, b = b, a", ""),
        ("a, b = divmod(x, y)", ""),
        ("area = 2.0 * width", ""),
        ("getattr(part, name)", ""),
    ],
)
def test_habits_are_told_from_what_looks_like_them(source: str, habit: str) -> None:
    """Each habit is found in one line of code; exchanges of values, results of a call and products are none."""
    nodes = list(ast.walk(ast.parse(source)))
    shown = {name for name, shows in habits.SYNTAX_HABITS.items() if any(map(shows, nodes))}
    assert shown == ({habit} if habit else set())


@pytest.mark.parametrize(("allowed", "code"), [(2, 1), (3, 0), (4, 1)])
def test_counts_may_only_fall(allowed: int, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More places than written down are refused, and fewer have to be written down."""
    counts = tmp_path / "habits.json"
    counts.write_text(json.dumps({"exec": allowed}))
    monkeypatch.setattr(habits, "COUNTS", counts)
    monkeypatch.setattr(habits, "find_habits", lambda: {"exec": [("a.py", 1), ("a.py", 2), ("b.py", 7)]})
    monkeypatch.setattr(sys, "argv", ["habits"])
    assert habits.main() == code
    monkeypatch.setattr(sys, "argv", ["habits", "--write"])
    assert habits.main() == int(allowed == 2)
    assert json.loads(counts.read_text())["exec"] == min(allowed, 3)
