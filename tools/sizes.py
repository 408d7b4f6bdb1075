"""Print lines, modules and statements of each folder beside its budget.

    python -m tools.sizes

Lines are those of all tracked Python files, docstrings and blank lines included. Statements are nodes of the syntax
tree, without imports and docstrings, so that neither formatting nor documentation counts. Exit code 1 above a budget.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("rx90_common", "rx90_sim", "rx90_controller", "friction_bench", "rx90_emulator")
LINES = {
    "rx90_common": 14_500, "rx90_common/bags": 4_400, "rx90_common/exchange": 2_800, "rx90_common/report": 500,
    "rx90_sim": 2_600, "rx90_controller": 5_000, "friction_bench": 4_500, "rx90_emulator": 20_000,
    "rx90_emulator/identification": 9_000, "rx90_emulator/view": 2_800, "test": 30_000, "benchmarks": 5_000,
}  # fmt: skip
MODULES = {"rx90_common": 95, "rx90_sim": 18, "rx90_controller": 30, "friction_bench": 30, "rx90_emulator": 105}
PRODUCT_LINES, PRODUCT_MODULES, PRODUCT_STATEMENTS = 46_000, 300, 21_500
FRAGMENT_LINES = 60


def statements(tree: ast.AST) -> int:
    """Count the statements of a syntax tree that are neither imports nor docstrings."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.stmt))
    return sum(not isinstance(node, ast.Import | ast.ImportFrom) and not _is_text(node) for node in nodes)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def main() -> int:
    """Print the table."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in listed.split() if (ROOT / name).is_file()}
    product = [name for name in texts if name.split("/")[0] in ROOMS]
    rows = [("all product", product, PRODUCT_LINES, PRODUCT_MODULES)]
    for folder, budget in LINES.items():
        within = [name for name in texts if name.startswith(f"{folder}/")]
        rows.append((folder, within, budget, MODULES.get(folder, 0)))
    above = False
    print(f"{'':30} {'lines':>7} {'budget':>7} {'modules':>8} {'budget':>7} {'statements':>11} {'fragments':>10}")
    for title, names, most_lines, most_modules in rows:
        lines = {name: len(texts[name].splitlines()) for name in names}
        count = sum(statements(ast.parse(texts[name])) for name in names)
        fragments = sum(size < FRAGMENT_LINES for name, size in lines.items() if not name.endswith("__init__.py"))
        total = sum(lines.values())
        above |= total > most_lines or (most_modules > 0 and len(names) > most_modules)
        above |= title == "all product" and count > PRODUCT_STATEMENTS
        shown = str(most_modules) if most_modules else ""
        print(f"{title:30} {total:7} {most_lines:7} {len(names):8} {shown:>7} {count:11} {fragments:10}")
    print(f"statements of the product: at most {PRODUCT_STATEMENTS}; fragments: modules below {FRAGMENT_LINES} lines")
    return int(above)


if __name__ == "__main__":
    sys.exit(main())
