"""Print how large the project is, by folder, beside what it is to be.

    python -m tools.sizes

The goals are the project's own upper limits: a change may not raise a figure above its goal without need.

Tokens are those of Python's tokenizer in product files, without comments, docstrings, blank lines and
indentation: neither formatting nor documentation counts. An option is a call of `add_argument` with a name that begins
with a dash, wherever it is declared. Words are those of the Markdown pages of docs/, as `wc -w` counts them.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("rx90_common", "rx90_sim", "rx90_controller", "friction_bench", "rx90_emulator")
FOLDERS = (
    "rx90_common",
    "rx90_common/bags",
    "rx90_common/exchange",
    "rx90_common/report",
    "rx90_sim",
    "rx90_controller",
    "friction_bench",
    "rx90_emulator",
    "rx90_emulator/cabinet",
    "rx90_emulator/cli",
    "rx90_emulator/configuration",
    "rx90_emulator/conformance",
    "rx90_emulator/correction",
    "rx90_emulator/export",
    "rx90_emulator/identification",
    "rx90_emulator/loop",
    "rx90_emulator/sweep",
    "rx90_emulator/view",
    "rx90_emulator/vplus",
)
TOKEN_GOALS = {
    "": 345_000,
    "rx90_emulator/identification": 62_000,
    "rx90_common/bags": 22_000,
    "rx90_emulator/view": 12_000,
    "rx90_emulator/vplus": 16_000,
    "friction_bench": 28_000,
}
_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


@dataclass(frozen=True)
class Size:
    """How large a product file is.

    Attributes:
        tokens: without comments, docstrings and layout.
        code_lines: lines on which a token stands.
        lines: all of them.
    """

    tokens: int
    code_lines: int
    lines: int


def measure(source: str) -> Size:
    """Measure the source text of a Python file."""
    docstrings = docstring_lines(ast.parse(source))
    tokens = 0
    depth = 0  # of formatted strings, which are tokens of several parts from Python 3.12 on, and one before
    code_lines = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        is_docstring = token.type == tokenize.STRING and token.start[0] in docstrings
        if token.type in _LAYOUT or is_docstring:
            continue
        name = tokenize.tok_name[token.type]
        if depth == 0:
            tokens += 1
            code_lines.add(token.start[0])
        depth += (name == "FSTRING_START") - (name == "FSTRING_END")
    return Size(tokens, len(code_lines), source.count("\n"))


def docstring_lines(tree: ast.AST) -> set[int]:
    """Return the lines on which the docstrings of modules, classes and functions begin."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    lines = set()
    for node in ast.walk(tree):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            lines.add(node.body[0].lineno)
    return lines


def count_options(source: str) -> int:
    """Count the options that a Python file declares for command lines."""
    return sum(_declares_option(node) for node in ast.walk(ast.parse(source)))


def _declares_option(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args):
        return False
    name = node.args[0]
    if isinstance(name, ast.JoinedStr):
        name = name.values[0]
    if not (isinstance(name, ast.Constant) and isinstance(name.value, str)):
        return False
    return node.func.attr == "add_argument" and name.value.startswith("-")


def files(*patterns: str) -> list[str]:
    """Return the files of these patterns, relative to the root, in their order."""
    return sorted(
        str(path.relative_to(ROOT)) for pattern in patterns for path in ROOT.glob(pattern)
    )


def main() -> int:
    """Print the tables."""
    sources = {name: _read(name) for name in files(*(f"{room}/**/*.py" for room in ROOMS))}
    sizes = {name: measure(source) for name, source in sources.items()}
    print(f"{'':30} {'tokens':>8} {'goal':>8} {'a line':>7} {'lines':>7} {'modules':>8}")
    for folder in ("", *FOLDERS):
        inside = [
            size for name, size in sizes.items() if folder == "" or name.startswith(f"{folder}/")
        ]
        tokens = sum(size.tokens for size in inside)
        code_lines = sum(size.code_lines for size in inside)
        lines = sum(size.lines for size in inside)
        goal = TOKEN_GOALS.get(folder, "")
        title = folder or "all product code"
        print(
            f"{title:30} {tokens:8} {goal:>8} {tokens / max(code_lines, 1):7.2f} {lines:7} {len(inside):8}"
        )

    options = sum(count_options(source) for source in sources.values())
    words = sum(len(_read(name).split()) for name in files("docs/**/*.md"))
    test_lines = sum(_read(name).count("\n") for name in files("test/**/*.py"))
    print()
    print(f"{'':30} {'now':>8} {'goal':>8}")
    print(f"{'commands':30} {len(_commands()):8} {5:8}")
    print(f"{'options':30} {options:8} {150:8}")
    print(f"{'names of the Python API':30} {len(_api_names()):8} {70:8}")
    print(f"{'words of docs':30} {words:8} {55_000:8}")
    print(f"{'lines of tests':30} {test_lines:8} {33_000:8}")
    return 0


def _read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _commands() -> list[str]:
    listed = re.search(r"EXECUTABLES = \((.*?)\)", _read("setup.py"), re.DOTALL)
    return re.findall(r'"(\w+)"', listed[1]) if listed else []


def _api_names() -> set[str]:
    return set(
        re.findall(
            r"\bas (\w+)", "\n".join(_type_checking_imports(_read("rx90_emulator/__init__.py")))
        )
    )


def _type_checking_imports(source: str) -> list[str]:
    tree = ast.parse(source)
    guards = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    return [ast.unparse(statement) for guard in guards for statement in guard.body]


if __name__ == "__main__":
    sys.exit(main())
