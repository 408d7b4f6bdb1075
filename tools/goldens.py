"""Write what users rely on as text files, and compare two such folders: the guard of a change that is to alter nothing.

    python -m tools.goldens write out/goldens/before               # at the commit that the change begins with
    python -m tools.goldens write out/goldens/after                # at any later step
    python -m tools.goldens compare out/goldens/before out/goldens/after

`--only help api` leaves the slow parts out. The parts are: `help` of all commands and verbs; `api`, the names and
signatures of `rx90_emulator`, to which others may be added; `schemas`; `sliding`, the shipped plan run on the engine
and identified; `excitation_rx90b` and `excitation_tx40`, excitation runs of both robots. Texts have to be the same. So
have numbers in them, to 1e-9 relative; those of physically consistent bodies (`robot.urdf`), which an iterative solver
finds, to 1e-6.
The digests of everything that is the same to the last bit are the matter of `python -m tools.digests`.

Exit code 1 if something differs; each difference is one line.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RELATIVE = 1e-9
SOLVER_RELATIVE = 1e-6
NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")
HIDDEN_TAGS = {"script", "style", "svg", "template"}


def _run(*words: str, cwd: Path | None = None) -> str:
    """Run a command of the suite and return its output; exit codes 0 and 1 are both results."""
    environment = {
        **os.environ,
        "COLUMNS": "120",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, str(ROOT / "rx90_emulator" / "__main__.py"), *words]
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode > 1:
        raise SystemExit(f"{' '.join(words)}: exit code {done.returncode}: {done.stderr.strip()}")
    return f"{done.stdout}\nexit code {done.returncode}\n"


def _help() -> Iterator[tuple[str, str]]:
    from rx90_emulator.cli.frame import COMMANDS

    for name in sorted(COMMANDS):
        text = _run(*name.split(), "--help")
        yield name.replace(" ", "_"), text
        verbs = re.search(r"positional arguments:\n  \S+(?: \.\.\.)?\n((?:    .*\n)+)", text)
        for verb in re.findall(r"^    (\w\S*)", verbs[1], re.MULTILINE) if verbs else ():
            yield f"{name.replace(' ', '_')}_{verb}", _run(*name.split(), verb, "--help")


def _plain_type(text: str) -> str:
    """Return a type without what is declared beside it."""
    declared = re.match(r"Annotated\[\s*(.*?), *(?=_?[A-Za-z]+[(,\]])", text, re.DOTALL)
    return declared[1] if declared else text


def _api() -> Iterator[tuple[str, str]]:
    import rx90_emulator as rx

    lines = []
    for name in sorted(rx.__all__):
        value = getattr(rx, name)
        if inspect.isclass(value):
            lines.append(f"class {name}")
            fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
            lines += [f"  {name}.{field.name}: {_plain_type(str(field.type))}" for field in fields]
            public = (one for one in dir(value) if not one.startswith("_"))
            lines += [f"  {name}.{one}{_signature(getattr(value, one, None))}" for one in public]
        else:
            lines.append(f"{name}{_signature(value)}")
    yield "names", "\n".join(lines) + "\n"


def _signature(value: object) -> str:
    if not (inspect.isfunction(value) or inspect.ismethod(value)):
        return ""
    return re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(value)))


def _schemas() -> Iterator[tuple[str, str]]:
    for file in sorted((ROOT / "config" / "schemas").glob("*.json")):
        yield file.stem, file.read_text(encoding="utf-8")


def _identified(*options: str, excitation: bool = False) -> Callable[[], Iterator[tuple[str, str]]]:
    """Return what runs a plan on the engine, identifies from its bags, and yields terminal, files and report."""

    def parts() -> Iterator[tuple[str, str]]:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            kind = "excitation" if excitation else "sliding"
            _run("rx90", "experiment", kind, "engine", *options, "--output", "series", cwd=folder)
            robot = [word for word in options if word == "--robot" or word in ("rx90b", "tx40")]
            output = "identified" if excitation else "friction.yaml"
            yield (
                "terminal",
                _run("rx90", "identify", kind, "series", "--output", output, *robot, cwd=folder),
            )
            written = folder / output
            for file in (
                sorted(written.iterdir()) if excitation else (written, written.with_suffix(".html"))
            ):
                if file.suffix in (".yaml", ".urdf", ".csv", ".json"):
                    yield file.name, file.read_text(encoding="utf-8")
                elif file.suffix == ".html":
                    yield file.name, _Page.text(file.read_text(encoding="utf-8"))

    return parts


class _Page(HTMLParser):
    """The words of a page, a line for each element that has any."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self.hidden = 0

    @classmethod
    def text(cls, page: str) -> str:
        """Return the words of a page."""
        parser = cls()
        parser.feed(page)
        return "\n".join(parser.words) + "\n"

    def handle_starttag(self, tag: str, _attrs: object) -> None:
        self.hidden += tag in HIDDEN_TAGS

    def handle_endtag(self, tag: str) -> None:
        self.hidden -= tag in HIDDEN_TAGS

    def handle_data(self, data: str) -> None:
        if not self.hidden and data.strip():
            self.words.append(" ".join(data.split()))


PARTS: dict[str, Callable[[], Iterator[tuple[str, str]]]] = {
    "help": _help,
    "api": _api,
    "schemas": _schemas,
    "sliding": _identified(),
    "excitation_rx90b": _identified("--robot", "rx90b", excitation=True),
    "excitation_tx40": _identified("--robot", "tx40", excitation=True),
}


def write(folder: Path, only: list[str]) -> None:
    """Write the texts of the chosen parts, each part whole or not at all."""
    for name in only or PARTS:
        print(f"goldens: {name}", file=sys.stderr)
        part = folder / name
        texts = dict(PARTS[name]())
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        for title, text in texts.items():
            (part / f"{title}.txt").write_text(_plain(text), encoding="utf-8")


def _plain(text: str) -> str:
    """Return a text without what is another in each run: hashes of bags, dates, scratch folders, times taken."""
    # not the digits behind a point
    text = re.sub(r"(?<![.\w])(?=\w*[a-f])[0-9a-f]{12,64}\b", "HASH", text)
    text = re.sub(
        r"\b20\d\d-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d)?(?:Z|[+-]\d\d:\d\d| UTC)?)?", "DATE", text
    )
    text = re.sub(r"/\S*/tmp\w+|/tmp/\w+", "SCRATCH", text)
    return re.sub(r"\b\d+(?:\.\d+)? s of computing", "TIME of computing", text)


def differences(before: Path, after: Path) -> Iterator[str]:
    """Yield a line for each file and line that differs between two folders of goldens."""
    names = {file.relative_to(one) for one in (before, after) for file in one.rglob("*.txt")}
    for name in sorted(names):
        if not (before / name).is_file() or not (after / name).is_file():
            yield f"{name}: only in {before if (before / name).is_file() else after}"
            continue
        tolerance = SOLVER_RELATIVE if "urdf" in name.name else RELATIVE
        old, new = (
            (one / name).read_text(encoding="utf-8").splitlines() for one in (before, after)
        )
        if name.parts[0] == "api":
            yield from (f"{name}: {line!r} is gone" for line in old if line not in new)
            continue
        if len(old) != len(new):
            yield f"{name}: {len(old)} lines before, {len(new)} after"
        for number, (was, now) in enumerate(zip(old, new, strict=False), 1):
            if not _same(was, now, tolerance):
                yield f"{name}:{number}: {was!r} -> {now!r}"
                if len(old) != len(new):
                    break  # what follows is shifted


def _same(was: str, now: str, tolerance: float) -> bool:
    if was == now:
        return True
    if NUMBER.sub("#", was) != NUMBER.sub("#", now):
        return False
    pairs = zip(map(float, NUMBER.findall(was)), map(float, NUMBER.findall(now)), strict=True)
    return all(abs(old - new) <= tolerance * max(abs(old), abs(new)) for old, new in pairs)


def main() -> int:
    """Write or compare goldens."""
    parser = argparse.ArgumentParser(
        description="Write what users rely on as text, or compare two such folders."
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    writing = verbs.add_parser("write", help="write the texts of this checkout into a folder")
    writing.add_argument("folder", type=Path)
    writing.add_argument(
        "--only", nargs="+", choices=list(PARTS), default=[], help="only these parts"
    )
    comparing = verbs.add_parser("compare", help="compare two folders; exit code 1 if they differ")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.verb == "write":
        write(options.folder, options.only)
        return 0
    found = list(differences(options.before, options.after))
    print("\n".join(found) or "same")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
