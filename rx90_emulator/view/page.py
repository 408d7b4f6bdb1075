"""The page: a server on this machine, tabs for parts, the one thread on which they work, and where it writes."""

from __future__ import annotations

import heapq
import html
import itertools
import logging
import os
import queue
import stat
import threading
import time
import webbrowser
from collections.abc import Callable, Coroutine, Mapping
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import rich
import viser
from viser import GuiInputHandle

from rx90_common.base.errors import ConfigError, Rx90Error, write_error
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.robot import RobotModel
from rx90_common.process.interrupts import deferred_interrupts
from rx90_common.report.plot import Panel
from rx90_emulator.view import OPENED, TO_OTHERS
from rx90_emulator.view.guard import PageGuard, listen


class ExistingFileError(ConfigError):
    """A file of this name exists; it is replaced only after the user has confirmed that."""


def output_folder(folder: Path) -> Path:
    """Return the absolute path of a folder for what the page writes, made where it is missing.

    Raises:
        Rx90Error: where it cannot be made, as `write_error` says.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return folder.resolve(strict=True)
    except OSError as error:
        raise write_error(folder, error, "a folder that exists or can be made") from error


def output_path(folder: Path, name: str, *, replace: bool = False) -> Path:
    """Return the path of a file or bag to be written; `name` may go through folders that exist in the given one.

    Links are refused, and names with a part that begins with a dot: they lead out of the folder, or to files that
    other programs obey.

    Args:
        folder: of the page, as `output_folder` returns it.
        name: as the user types it.
        replace: the user has confirmed that a file of this name is replaced.

    Raises:
        ExistingFileError: where a file stands there, and nobody has confirmed that it goes.
        ConfigError: for every other name that is not free, or leads elsewhere.
    """
    accepted = f"a new name beneath {plain(folder)}"
    hidden = any(part.startswith(".") for part in name.split("/"))
    if hidden or not name.strip() or not name.isprintable() or Path(name).is_absolute():
        raise ConfigError(f"{quoted(name)}; accepted: {accepted}, without parts that begin with a dot")
    path = folder / name
    try:
        if path.parent.resolve() != path.parent or not path.parent.is_dir():
            raise ConfigError(f"{quoted(name)} leads through a link, or no folder; accepted: {accepted}")
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return path
    except OSError as error:
        raise ConfigError(f"{quoted(name)}: {error.strerror}; accepted: {accepted}") from error
    if not stat.S_ISREG(mode):
        raise ConfigError(f"{quoted(name)} is no plain file; accepted: {accepted}")
    if not replace:
        raise ExistingFileError(f"{plain(path)} exists; accepted: {accepted}")
    return path


_LONGEST_WAIT = 0.05  # s, without a look for Ctrl-C
_BUSY_FACTOR = 3  # how much longer periods are while a part is busy
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_EYE = np.array([1.35, -1.15, 0.6])  # from the arm's centre, in lengths of the arm
_CENTER = np.array([0.25, 0.0, 0.4])
_FIELD_OF_VIEW = 0.75  # rad, upright
_MIN_ASPECT = 0.9  # width over height below which the arm is seen from farther away
_NARROW_DROP = 0.2  # by how much of its distance a narrow page looks below the arm
_PLOT_WIDTH = 370  # pixels
_PANEL_WIDTH = 310


class Page:
    """A page in the browser, served until `close`.

    Args:
        title: above the control panel.
        host: address to bind to; 127.0.0.1 is reached from this machine alone.
        port: to bind to; 0 takes a free one.
        output: the folder that files go into which are written on the page; made where it is missing.

    Attributes:
        server, gui, scene: viser's own.
        tab, plot_tab: add a tab with a label to the control panel, or to that of plots, to be filled in a `with` block.
        add_lines: adds line segments to the scene, float32 (n, 2, 3) m, as thick in pixels wherever the camera is.
        address: what to open in a browser; whoever has it can do what the page can.
        output: the folder's absolute path.
        panels: what each plot shows at the moment, by its title; for files.

    Raises:
        Rx90Error: if host and port cannot be bound to, or the folder cannot be made.
    """

    def __init__(self, title: str, host: str = "127.0.0.1", port: int = 8080, output: Path = Path()) -> None:
        self.output = output_folder(output)
        listener = listen(host, port)
        rich.get_console().quiet = True  # viser draws a box with addresses, and tells of each connection
        # Somebody closed a connection before it was one: a tab that was closed early, a scan of ports. Viser leaves
        # that out, too, but only from the first request on.
        logging.getLogger("websockets.server").addFilter(lambda said: said.getMessage() != "opening handshake failed")
        self._guard = PageGuard(title, host, listener)
        self.server = self._guard.server
        self.gui, self.scene = self.server.gui, self.server.scene
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{self.server.get_port()}/?token={self._guard.token}"
        # The button would ask another machine for a tunnel.
        self.gui.configure_theme(show_logo=False, show_share_button=False)
        self.gui.main_panel.dock_right()
        self.gui.main_panel.set_width(_PANEL_WIDTH)
        self.tab = self.gui.add_tab_group().add_tab
        plots = self.gui.add_panel()
        plots.dock_left()
        plots.set_width(_PLOT_WIDTH)
        self.plot_tab = partial(plots.add_tab, icon=viser.Icon.CHART_LINE)
        self.add_lines = partial(self.scene.add_line_segments, thickness_units="screen")
        self.panels: dict[str, Callable[[], Panel]] = {}
        # No SimpleQueue: its wait has no end where a signal is handled until after the time-out.
        self._handed_over: queue.Queue[Callable[[], None]] = queue.Queue()
        # When the next call is due, a number by which calls of one time are in order, and what `every` was given.
        self._timed: list[tuple[float, int, float, Callable[[float], None], Callable[[float], bool]]] = []
        self._numbers = itertools.count()
        self.scene.set_up_direction("+z")
        self.scene.world_axes.visible = False
        self.scene.add_grid("/floor", 2.4, 2.4, cell_size=0.1, section_size=0.5, position=(0.0, 0.0, -0.001))
        # The usual environment takes the colours away.
        self.scene.configure_environment_map("studio", environment_intensity=0.35)

    def look_at_arm(self, robot: RobotModel) -> None:
        """Place the camera of pages that are opened from now on, so that the whole arm is seen.

        On a narrow page the panels lie over the lower half: the arm is in the upper one.
        """
        reach = float(np.linalg.norm(robot.chain.origin, axis=1).sum())
        camera = self.server.initial_camera
        center = _CENTER * reach
        camera.position, camera.look_at, camera.fov = center + _EYE * reach, center, _FIELD_OF_VIEW

        def step_back(client: viser.ClientHandle) -> None:
            if client.camera.aspect < _MIN_ASPECT:
                away = _MIN_ASPECT / client.camera.aspect * _EYE * reach
                below = center - [0.0, 0.0, _NARROW_DROP * float(np.linalg.norm(away))]
                with client.atomic():
                    client.camera.position, client.camera.look_at = below + away, below

        self.server.on_client_connect(step_back)

    def every(
        self, period: float, function: Callable[[float], None], busy: Callable[[float], bool] = lambda _: False
    ) -> None:
        """Call `function(now)` every `period` s while the page runs, on its thread; late calls are left out.

        While `busy(now)` holds it is called a third as often.
        """
        heapq.heappush(self._timed, (time.monotonic(), next(self._numbers), period, function, busy))

    def later(self, function: Callable[[], None]) -> None:
        """Call `function()` once on the page's thread; from any thread."""
        self._handed_over.put(function)

    def announce(self, *, browser: bool) -> None:
        """Print the address, and open it in a browser if there is a screen; say when it is open."""
        unopened = threading.Lock()
        self.server.on_client_connect(lambda _: print(OPENED, flush=True) if unopened.acquire(blocking=False) else None)
        if self._guard.open_to_others:
            print(TO_OTHERS, flush=True)
        print(f"page: {self.address} (Ctrl-C ends it)", flush=True)
        if browser and any(os.environ.get(name) for name in _SCREENS):
            # Some browsers are waited for until they end.
            threading.Thread(target=webbrowser.open, args=[self.address], name="browser", daemon=True).start()

    def run(self, until: Callable[[], bool] = lambda: False, check_interrupt: Callable[[], None] | None = None) -> None:
        """Run the parts until `until()` holds.

        Args:
            until: asked between two calls.
            check_interrupt: likewise, of who holds interrupts back already; None: they are held back here.

        Raises:
            KeyboardInterrupt: on Ctrl-C, between two calls.
        """
        with nullcontext(check_interrupt) if check_interrupt else deferred_interrupts() as check:
            while not until():
                check()
                now, wait = time.monotonic(), _LONGEST_WAIT
                if self._timed:
                    due, _, period, function, busy = self._timed[0]
                    wait = min(wait, max(0.0, due - now))
                    if due <= now:
                        due = max(due + period * (_BUSY_FACTOR if busy(now) else 1), now)
                        heapq.heapreplace(self._timed, (due, next(self._numbers), period, function, busy))
                        with self.server.atomic():
                            function(now)
                with suppress(queue.Empty):
                    self._handed_over.get(timeout=wait)()

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()


_Value = TypeVar("_Value")


def put(field: GuiInputHandle[_Value], value: _Value) -> None:
    """Show a value in a field."""
    field.value = value  # type: ignore[misc]  # viser's setter does not stand beside its getter


def from_user(callback: Callable[[], None], page: Page) -> Callable[[object], Coroutine[Any, Any, None]]:
    """Return a callback of viser's that has `callback` called on the page's thread, for what a user does alone.

    It is a coroutine, because viser calls those in the order of what was done; functions it calls on many threads.
    """

    async def hand_over(event: object) -> None:
        if getattr(event, "client_id", None) is not None:
            page.later(callback)

    return hand_over


def on_change(field: GuiInputHandle[_Value], callback: Callable[[], None], page: Page) -> None:
    """Have `callback` called on the page's thread after a user has changed a field, with the user's value in it.

    The page may have put another value there in the meantime, while it did not know of the change: that one goes.
    """
    given = field.value  # the newest of a user

    def put_again() -> None:
        put(field, given)
        callback()

    hand_over = from_user(put_again, page)

    async def keep(event: object) -> None:
        # On the thread that has just set the value, before it takes the next message.
        nonlocal given
        if getattr(event, "client_id", None) is not None:
            given = field.value
        await hand_over(event)

    field.on_update(keep)


def numbers(text: str) -> list[float]:
    """Return the numbers in a text, separated by blanks or commas; none if it holds anything else."""
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return []


def block(content: str) -> str:
    """Return HTML as the panel shows text: small, and broken where it is too wide."""
    return f'<div style="padding:0 0.6em;font-size:0.8em;overflow-wrap:anywhere">{content}</div>'


def sentence(text: str, *, wrong: bool = False) -> str:
    """Return a sentence as HTML; of a refusal in red."""
    return block(f'<div style="color:{"#c92a2a" if wrong else "inherit"}">{html.escape(text)}</div>')


class FileFields:
    """A file's name, buttons that write it beneath the page's folder, and one that replaces a file that is there.

    Args:
        page: to build in, within a tab.
        label: of the name.
        name: at first.
        writers: by the label of a button, what is added to the name, and what writes the file at a path and returns
            what is said of it; may raise Rx90Error.
        said: at first, below.
    """

    def __init__(
        self, page: Page, label: str, name: str, writers: Mapping[str, tuple[str, Callable[[Path], str]]], said: str
    ) -> None:
        self._output = page.output
        self.name = page.gui.add_text(label, name)
        self.buttons = [page.gui.add_button(words) for words in writers]
        for writer, button in zip(writers.values(), self.buttons, strict=True):
            button.on_click(from_user(partial(self._write, *writer), page))
        self.replace = page.gui.add_button("Replace the file that is there", color="red", visible=False)
        self.replace.on_click(from_user(self._replace, page))
        self.said = page.gui.add_html(sentence(said))

    def withdraw(self) -> None:
        """Take back the offer to replace a file: what would be written is another one now."""
        self.replace.visible = False

    def _replace(self) -> None:
        if self.replace.visible:
            self._write(*self._refused)

    def _write(self, suffix: str, write: Callable[[Path], str], confirmed: str = "") -> None:
        name, wrong = f"{self.name.value}{suffix}", False
        self.withdraw()
        try:
            said = write(output_path(self._output, name, replace=name == confirmed))
        except Rx90Error as error:
            said, wrong = str(error), True
            if isinstance(error, ExistingFileError):
                self._refused, self.replace.visible = (suffix, write, name), True
        self.said.content = sentence(said, wrong=wrong)


_THREAD_END = 1.0  # s
_Given = TypeVar("_Given")
_Found = TypeVar("_Found")


class Checker(Generic[_Given, _Found]):
    """Checks the newest input on a thread of its own, and shows the verdict as a line of text.

    Args:
        page: to build in, within a tab, and on whose thread `give` is called.
        check: returns the result for an input, or raises Rx90Error; may take long, the next input waits for it.
        show: takes the result on the page's thread, None for a refusal, and returns the text to show; not called for
            an input that a newer one has replaced.
        interval: the shortest time from one check to the next, s.
    """

    def __init__(
        self, page: Page, check: Callable[[_Given], _Found], show: Callable[[_Found | None], str], interval: float
    ) -> None:
        self._page, self._check, self._show, self._interval = page, check, show, interval
        self._verdict = page.gui.add_html("")
        self._waiting: queue.SimpleQueue[tuple[int, _Given] | None] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._count = 0
        self._thread = threading.Thread(target=self._run, name="check", daemon=True)
        self._thread.start()

    def give(self, given: _Given) -> None:
        """Have an input checked, in place of any that still waits; returns at once."""
        self._count += 1
        self._verdict.content = sentence("checking ...")
        self._waiting.put((self._count, given))

    def close(self) -> None:
        """Drop what waits, and end the thread after what it works on, which may last longer than this waits."""
        self._closed.set()
        self._waiting.put(None)
        self._thread.join(_THREAD_END)

    def _run(self) -> None:
        while (newest := self._waiting.get()) is not None and not self._closed.is_set():
            number, given = newest
            if number == self._count:
                found: _Found | Rx90Error
                try:
                    found = self._check(given)
                except Rx90Error as error:
                    found = error
                self._page.later(partial(self._tell, number, found))
                self._closed.wait(self._interval)

    def _tell(self, number: int, found: _Found | Rx90Error) -> None:
        if number == self._count:
            refused = isinstance(found, Rx90Error)
            said = self._show(None if isinstance(found, Rx90Error) else found)
            self._verdict.content = sentence(str(found) if refused else said, wrong=refused)
