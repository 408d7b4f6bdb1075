"""Does what a page of docs/ tells its reader to do, block by block, and compares what it says comes out.

    ```yaml file=NAME        a file of that name; also python, which is then not run
    ```console               lines after "$ " are run, in order; what follows each is what it prints
    ```console terminal=NAME the first command of a terminal goes on; what follows is waited for. ^C interrupts it
    ```python                run, in one interpreter for the page
    ```text output           what the python block before it has printed
    ```... skip              not run

In an output `...` is any text, as in doctest, and runs of blanks are one. `echo $?` shows how the command before it
ended; without it that is to be 0. Blocks in other languages are for reading.
"""

import contextlib
import doctest
import io
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from processes import Processes

from rx90_common.process.children import ChildProcess, executable
from rx90_emulator.cli.frame import EXECUTABLES, run

_STAND_IN = Path(__file__).with_name("ros2_stand_in.py")
_TIMEOUT = 400.0  # s, of a command: generous, for a loaded machine with nothing compiled yet
_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
_HERE = {"rig", "bag", "correct", "experiment", "export", "identify", "line", "path", "replay", "run", "sweep"}
"""Verbs that are run in the process of the test, with the slow imports done: none of them is a node or goes on."""


@dataclass(frozen=True)
class Block:
    language: str
    words: tuple[str, ...]
    text: str
    line: int

    def value(self, key: str) -> str | None:
        return next((word.partition("=")[2] for word in self.words if word.startswith(f"{key}=")), None)


def blocks(page: Path) -> list[Block]:
    tokens = MarkdownIt().parse(page.read_text(encoding="utf-8"))
    fences = [token for token in tokens if token.type == "fence"]
    words = [token.info.split() or [""] for token in fences]
    return [Block(info[0], tuple(info[1:]), token.content, token.map[0] + 1)
            for info, token in zip(words, fences, strict=True)]  # fmt: skip


def commands(text: str) -> list[tuple[str, str]]:
    parts = re.split(r"^(\$ .*|\^C)\n", text, flags=re.MULTILINE)
    return [("", parts[0])] * bool(parts[0]) + [*zip(parts[1::2], parts[2::2], strict=True)]


def same(expected: str, output: str) -> bool:
    return doctest.OutputChecker().check_output(expected, output, _FLAGS)


class PageSession:
    def __init__(self, page: Path, processes: Processes) -> None:
        self._page, self._processes = page, processes
        self._terminals: dict[str, ChildProcess] = {}
        self._names: dict[str, object] = {}
        self._printed = ""
        self._code = 0

    def run(self) -> None:
        for block in blocks(self._page):
            where = f"{self._page.name}:{block.line}"
            if "skip" in block.words:
                continue
            if (name := block.value("file")) is not None:
                Path(name).write_text(block.text, encoding="utf-8")
            elif block.language == "console":
                for command, expected in commands(block.text):
                    self._command(command, expected, block.value("terminal"), where)
            elif block.language == "python":
                self._python(block)
            elif (block.language, block.words) == ("text", ("output",)):
                assert same(block.text, self._printed), f"{where}: expected\n{block.text}printed\n{self._printed}"
        assert self._code == 0, f"{self._page.name}: the last command ended with {self._code}"

    def _python(self, block: Block) -> None:
        printed = io.StringIO()
        code = compile("\n" * block.line + block.text, str(self._page), "exec")
        with contextlib.redirect_stdout(printed):
            exec(code, self._names)
        self._printed = printed.getvalue()

    def _command(self, line: str, expected: str, terminal: str | None, where: str) -> None:
        where += f": {line}"
        command = line.removeprefix("$ ")
        if terminal is not None:
            self._in_terminal(command, expected, terminal, where)
            return
        if command == "echo $?":
            assert expected == f"{self._code}\n", f"{where}: {self._code}"
            self._code = 0
            return
        assert self._code == 0, f"{where}: the command before it ended with {self._code}"
        done = self._done(self._words(command))
        self._code = done.returncode
        assert "\r" not in done.stderr + done.stdout, f"{where}: draws a progress bar where no terminal is"
        seen = (done.stdout, done.stderr + done.stdout)  # a reader may be shown either alone
        assert any(same(expected, text) for text in seen), f"{where}: expected\n{expected}came\n{seen[1]}"

    def _done(self, words: list[str]) -> subprocess.CompletedProcess[str]:
        python = executable("rx90")
        verb, *options = words[len(python) :] or [""]
        if words[: len(python)] != python or verb not in _HERE or options[:1] == ["emulator"]:
            return self._processes.run(*words, timeout=_TIMEOUT)
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
            code = run(f"rx90 {verb}", options)
        return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())

    def _in_terminal(self, command: str, expected: str, terminal: str, where: str) -> None:
        if command == "^C":
            process = self._terminals.pop(terminal)
            process.signal(signal.SIGINT)
            assert process.wait(_TIMEOUT) == 0, f"{where}: {process.output}"
            assert not expected or same(f"...{expected}", process.output), f"{where}: {process.output}"
            return
        if command:
            assert terminal not in self._terminals, f"{where}: {terminal} is busy"
            self._terminals[terminal] = self._processes.start(*self._words(command))
        process = self._terminals[terminal]
        for part in filter(None, (part.strip() for part in expected.split("..."))):
            process.wait_for(re.escape(part), _TIMEOUT)

    def _words(self, line: str) -> list[str]:
        first = line.split(maxsplit=1)[0]
        if first == "python":
            return [sys.executable, *shlex.split(line)[1:]]
        if first not in EXECUTABLES and first != "ros2":
            folder = Path(sys.executable).parent
            return ["/bin/bash", "-c", f"PATH={folder}:$PATH; {line}"]
        expanded = ["bash", "-c", f"printf '%s\\0' {line}"]
        words = subprocess.run(expanded, capture_output=True, text=True, check=True).stdout.split("\0")[:-1]
        words = [sys.executable if word == "python" else word for word in words]
        if first == "ros2":
            return [sys.executable, str(_STAND_IN), *words[1:]]
        return executable(words[0], *words[1:])
