"""Measure how much memory `rx90_bag export` takes for a bag, and for one ten times as long; and so for `import`.

    python -m benchmarks.bag_memory [ROWS]

The log holds position, velocity and effort of six joints. Prints the peak of each command in a process of its own, and
merges the ratios into out/bench.json.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.report import ROOT, merge, print_table
from rx90_common.bags.topics import FIELDS
from rx90_common.process.children import executable

ROWS = 40_000
TIMES = 10
RATE = 4000  # Hz
JOINTS = 6
_PERIOD = 0.005  # s
_ANONYMOUS = re.compile(r"^RssAnon:\s+(\d+) kB", re.MULTILINE)
MAPPING = "time: {{column: 1, unit: s}}\ndelimiter: ','\nheader: 1\nexact: {exact}\ntopics:\n  joint_states:\n"


def write_log(folder: Path, rows: int, *, exact: bool) -> Path:
    """Write a log and its mapping; return the log."""
    log = folder / f"{'exact' if exact else 'log'}.csv"
    units = dict(zip(FIELDS, ("rad", "rad/s", "Nm"), strict=True))
    mapping = MAPPING.format(exact=str(exact).lower()) + f"    names: [{', '.join(f'j{k}' for k in range(JOINTS))}]\n"
    for k, (field, unit) in enumerate(units.items()):
        columns = list(range(2 + k * JOINTS, 2 + (k + 1) * JOINTS))
        mapping += f"    {field}: {{columns: {columns}, unit: {unit}}}\n"
    log.with_suffix(".yaml").write_text(mapping, encoding="utf-8")
    rng = np.random.default_rng(1)
    with log.open("w", encoding="utf-8") as file:
        file.write(",".join(["t", *(f"c{k}" for k in range(3 * JOINTS))]) + "\n")
        for row in range(rows):
            file.write(f"{row / RATE!r},{','.join(map(repr, rng.standard_normal(3 * JOINTS).tolist()))}\n")
    return log


def peak(*words: str | Path) -> int:
    """Return the largest memory of a command, bytes: without the bag's pages, which the system may drop at any time.

    Raises:
        RuntimeError: if it fails.
    """
    child = subprocess.Popen(executable("rx90_bag", *words), cwd=ROOT, stdout=subprocess.DEVNULL)
    status, largest = Path(f"/proc/{child.pid}/status"), 0
    while child.poll() is None:
        found = _ANONYMOUS.search(status.read_text(encoding="ascii"))
        largest = max(largest, 1024 * int(found[1]) if found else 0)
        time.sleep(_PERIOD)
    if child.returncode:
        raise RuntimeError(f"rx90_bag {words[0]} ended with {child.returncode}")
    return largest


def peaks(rows: int) -> dict[str, int]:
    """Return the peak of each command by its name, for a log of so many rows."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for exact, what in ((False, "import"), (True, "import exact")):
            log = write_log(folder, rows, exact=exact)
            found[what] = peak("import", log, folder / what)
            log.unlink()
        for suffix in ("csv", "npz", "parquet"):
            found[f"export {suffix}"] = peak("export", folder / "import", "--output", folder / f"out.{suffix}")
            (folder / f"out.{suffix}").unlink()
    return found


def main() -> None:
    """Measure both lengths and print what came out."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else ROWS
    short, long = peaks(rows), peaks(TIMES * rows)
    ratios = {what: long[what] / short[what] for what in short}
    table = [[what, f"{short[what] / 1e6:.0f}", f"{long[what] / 1e6:.0f}", f"{ratios[what]:.2f}"] for what in short]
    print_table(["command", f"{rows} rows, MB", f"{TIMES * rows} rows, MB", "ratio"], table)
    merge({f"bag_memory_{what.replace(' ', '_')}_ratio": ratio for what, ratio in ratios.items()})


if __name__ == "__main__":
    main()
