"""The page: a server on this machine, tabs for parts, the one thread on which they work, and where it writes."""

from __future__ import annotations

import heapq
import html
import ipaddress
import itertools
import logging
import os
import queue
import socket
import stat
import threading
import time
import webbrowser
from collections.abc import Callable, Coroutine, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import rich
import viser
from numpy.typing import NDArray
from viser import GuiInputHandle

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, Rx90Error, write_error
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.robot import RobotModel
from rx90_common.process.interrupts import interrupts_later
from rx90_common.report.plot import Panel
from rx90_emulator.view import OPENED, TO_OTHERS
from rx90_emulator.view.guard import PageGuard


class ExistingFileError(ConfigError):
    """A file stands under the name; a user who confirms it may have it replaced."""


class OutputFolder:
    """A folder, and what a user of the page may name in it.

    Args:
        folder: made where it is missing.

    Raises:
        Rx90Error: where it cannot be made, as `write_error` says.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.folder = folder.resolve(strict=True)
        except OSError as error:
            raise write_error(folder, error, "a folder that exists or can be made") from error

    def path_for(self, name: str, *, replace: bool = False) -> Path:
        """Return the path of a file or bag to be written; `name` may go through folders that exist in this one.

        Links are refused, and names with a part that begins with a dot: they lead out of the folder, or to files
        that other programs obey.

        Args:
            name: as the user types it.
            replace: the user has confirmed that a file of this name is replaced.

        Raises:
            ExistingFileError: where a file stands there, and nobody has confirmed that it goes.
            ConfigError: for every other name that is not free, or leads elsewhere.
        """
        accepted = f"a new name beneath {plain(self.folder)}"
        hidden = any(part.startswith(".") for part in name.split("/"))
        if hidden or not name.strip() or not name.isprintable() or Path(name).is_absolute():
            raise ConfigError(f"{quoted(name)}; accepted: {accepted}, without parts that begin with a dot")
        path = self.folder / name
        try:
            if path.parent.resolve() != path.parent or not path.parent.is_dir():
                raise ConfigError(f"{quoted(name)} leads through a link, or no folder; accepted: {accepted}")
            there = path.lstat()
        except FileNotFoundError:
            return path
        except OSError as error:
            raise ConfigError(f"{quoted(name)}: {error.strerror}; accepted: {accepted}") from error
        if not stat.S_ISREG(there.st_mode):
            raise ConfigError(f"{quoted(name)} is no plain file; accepted: {accepted}")
        if not replace:
            raise ExistingFileError(f"{plain(path)} exists; accepted: {accepted}")
        return path


_LONGEST_WAIT = 0.05  # s, without a look for Ctrl-C
_LESS_OFTEN = 3
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_FROM = np.array([1.35, -1.15, 0.6])  # towards the eye, in lengths of the arm
_FIELD = 0.75  # rad, upright
_NARROW = 0.9  # width over height below which the arm is seen from farther away
_SHARE_BELOW = 0.2  # by how much of its distance a narrow page looks below the arm
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
        address: what to open in a browser; whoever has it can do what the page can.
        output: gives the path for every name of a file that a user types.
        panels: what each plot shows at the moment, by its title; for files.

    Raises:
        Rx90Error: if host and port cannot be bound to, or the folder cannot be made.
    """

    def __init__(self, title: str, host: str = "127.0.0.1", port: int = 8080, output: Path = Path()) -> None:
        self.output = OutputFolder(output)
        _check_free(host, port)
        rich.get_console().quiet = True  # viser draws a box with addresses, and tells of each connection
        # viser filters them, too, but only from the first request on.
        logging.getLogger("websockets.server").addFilter(_of_interest)
        self._open_to_others = reached_by_others(host)
        self._guard = PageGuard(title, host, port, open_to_others=self._open_to_others)
        self.server = self._guard.server
        if port not in {0, self.server.get_port()}:  # somebody was faster, and viser has gone on to the next one
            self.server.stop()
            raise _taken(host, port, "taken a moment ago")
        self.gui, self.scene = self.server.gui, self.server.scene
        shown = f"[{host}]" if ":" in host else host
        self.address = f"http://{shown}:{self.server.get_port()}/?token={self._guard.token}"
        # The button would ask another machine for a tunnel.
        self.gui.configure_theme(show_logo=False, show_share_button=False)
        self.gui.main_panel.dock_right()
        self.gui.main_panel.set_width(_PANEL_WIDTH)
        self._tabs = self.gui.add_tab_group()
        self._plots = self.gui.add_panel()
        self._plots.dock_left()
        self._plots.set_width(_PLOT_WIDTH)
        self.panels: dict[str, Callable[[], Panel]] = {}
        # No SimpleQueue: its wait has no end where a signal is handled until after the time-out.
        self._handed_over: queue.Queue[Callable[[], None]] = queue.Queue()
        # When the next call is due, a number by which calls of one time are in order, and what `every` was given.
        self._timed: list[tuple[float, int, float, Callable[[float], None], Callable[[float], bool]]] = []
        self._numbers = itertools.count()
        self._opened = False
        _furnish(self.scene)

    def add_lines(
        self,
        name: str,
        points: Array,
        colors: NDArray[Any] | tuple[int, int, int],
        thickness: float,
        *,
        visible: bool = True,
    ) -> viser.LineSegmentsHandle:
        """Add line segments to the scene, (n, 2, 3) m, as thick in pixels wherever the camera is."""
        return self.scene.add_line_segments(
            name, points.astype(np.float32), colors, thickness=thickness, thickness_units="screen", visible=visible
        )

    def tab(self, label: str) -> AbstractContextManager[object]:
        """Add a tab to the control panel, to be filled in a `with` block."""
        return self._tabs.add_tab(label)

    def plot_tab(self, label: str) -> AbstractContextManager[object]:
        """Add a tab to the panel of plots, to be filled in a `with` block."""
        return self._plots.add_tab(label, viser.Icon.CHART_LINE)

    def look_at_arm(self, robot: RobotModel) -> None:
        """Place the camera of pages that are opened from now on, so that the whole arm is seen.

        On a narrow page the panels lie over the lower half: the arm is in the upper one.
        """
        reach = float(np.linalg.norm(robot.chain.origin, axis=1).sum())
        camera = self.server.initial_camera
        center = np.array([0.25, 0.0, 0.4]) * reach
        camera.position, camera.look_at = center + _FROM * reach, center
        camera.fov = _FIELD

        def step_back(client: viser.ClientHandle) -> None:
            if client.camera.aspect < _NARROW:
                away = _NARROW / client.camera.aspect * _FROM
                below = center - [0.0, 0.0, _SHARE_BELOW * float(np.linalg.norm(away)) * reach]
                with client.atomic():
                    client.camera.position, client.camera.look_at = below + away * reach, below

        self.server.on_client_connect(step_back)

    def every(
        self, period: float, function: Callable[[float], None], hurries: Callable[[float], bool] = lambda _: False
    ) -> None:
        """Call `function(now)` every `period` s while the page runs, on its thread; late calls are left out.

        While `hurries(now)` holds it is called a third as often.
        """
        heapq.heappush(self._timed, (time.monotonic(), next(self._numbers), period, function, hurries))

    def later(self, function: Callable[[], None]) -> None:
        """Call `function()` once on the page's thread; from any thread."""
        self._handed_over.put(function)

    def announce(self, *, browser: bool) -> None:
        """Print the address, and open it in a browser if there is a screen; say when it is open."""
        self.server.on_client_connect(lambda _: self.later(self._say_opened))
        if self._open_to_others:
            print(TO_OTHERS, flush=True)
        print(f"page: {self.address} (Ctrl-C ends it)", flush=True)
        if browser and any(os.environ.get(name) for name in _SCREENS):
            # Some browsers are waited for until they end.
            threading.Thread(target=webbrowser.open, args=[self.address], name="browser", daemon=True).start()

    def _say_opened(self) -> None:
        if not self._opened:
            self._opened = True
            print(OPENED, flush=True)

    def run(self, until: Callable[[], bool] = lambda: False, check_interrupt: Callable[[], None] | None = None) -> None:
        """Run the parts until `until()` holds.

        Args:
            until: asked between two calls.
            check_interrupt: likewise, of who holds interrupts back already; None: they are held back here.

        Raises:
            KeyboardInterrupt: on Ctrl-C, between two calls.
        """
        with nullcontext(check_interrupt) if check_interrupt else interrupts_later() as check:
            while not until():
                check()
                self._step()

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()

    def _step(self) -> None:
        """Do what is due, or wait a moment for what is handed over."""
        now = time.monotonic()
        wait = _LONGEST_WAIT
        if self._timed:
            due, _, period, function, hurries = self._timed[0]
            if due <= now:
                next_due = max(due + period * (_LESS_OFTEN if hurries(now) else 1), now)
                heapq.heapreplace(self._timed, (next_due, next(self._numbers), period, function, hurries))
                with self.server.atomic():
                    function(now)
                wait = 0.0
            else:
                wait = min(wait, due - now)
        with suppress(queue.Empty):
            self._handed_over.get(timeout=wait)()


def reached_by_others(host: str) -> bool:
    """Return whether a server on this address, a name or a number, is open to other machines."""
    place = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][4][0]
    return not ipaddress.ip_address(str(place).partition("%")[0]).is_loopback


def _of_interest(record: logging.LogRecord) -> bool:
    """Leave out that somebody closed a connection before it was one: a tab that was closed early, a scan of ports."""
    return record.getMessage() != "opening handshake failed"


def _furnish(scene: viser.SceneApi) -> None:
    """Lay the floor, and light the scene."""
    scene.set_up_direction("+z")
    scene.world_axes.visible = False
    scene.add_grid("/floor", 2.4, 2.4, cell_size=0.1, section_size=0.5, position=(0.0, 0.0, -0.001))
    # The usual environment takes the colours away.
    scene.configure_environment_map("studio", environment_intensity=0.35)


def _check_free(host: str, port: int) -> None:
    """Refuse what cannot be bound to; viser would take the next port that it can, and not say so."""
    try:
        kind, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"--host {quoted(host)}: {reason}; accepted: an address of this machine") from error
    with socket.socket(kind, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(place)
            probe.listen(1)
        except OSError as error:
            raise _taken(host, port, error.strerror or str(error)) from error


def _taken(host: str, port: int, reason: str) -> ConfigError:
    return ConfigError(
        f"{host} port {port}: {reason}; accepted: --port with a free one, or 0 for any, and an address of this machine"
    )


_Value = TypeVar("_Value")


def put(field: GuiInputHandle[_Value], value: _Value) -> None:
    """Show a value in a field."""
    field.value = value  # type: ignore[misc]  # viser's setter does not stand beside its getter


def from_user(callback: Callable[[], None], page: Page) -> Callable[[object], Coroutine[Any, Any, None]]:
    """Return a callback of viser's that has `callback` called on the page's thread, for what a user does alone.

    It is a coroutine, because viser calls those in the order of what was done; functions it calls on many threads.
    """

    async def take(event: object) -> None:
        if getattr(event, "client_id", None) is not None:
            page.later(callback)

    return take


def on_change(field: GuiInputHandle[_Value], callback: Callable[[], None], page: Page) -> None:
    """Have `callback` called on the page's thread after a user has changed a field, with the user's value in it.

    The page may have put another value there in the meantime, while it did not know of the change: that one goes.
    """
    given = [field.value]  # the newest of a user

    def taken() -> None:
        put(field, given[0])
        callback()

    hand_over = from_user(taken, page)

    async def take(event: object) -> None:
        # On the thread that has just set the value, before it takes the next message.
        if getattr(event, "client_id", None) is not None:
            given[0] = field.value
        await hand_over(event)

    field.on_update(take)


def block(content: str) -> str:
    """Return HTML as the panel shows text: small, and broken where it is too wide."""
    return f'<div style="padding:0 0.6em;font-size:0.8em;overflow-wrap:anywhere">{content}</div>'


def sentence(text: str, *, wrong: bool = False) -> str:
    """Return a sentence as HTML; of a refusal in red."""
    return block(f'<div style="color:{"#c92a2a" if wrong else "inherit"}">{html.escape(text)}</div>')


_THREAD_END = 1.0  # s
_Item = TypeVar("_Item")


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
        self.buttons = {words: page.gui.add_button(words) for words in writers}
        for words, button in self.buttons.items():
            button.on_click(from_user(partial(self._write, *writers[words]), page))
        self.replace = page.gui.add_button("Replace the file that is there", color="red", visible=False)
        self.replace.on_click(from_user(self._confirm, page))
        self._confirmed: Callable[[], None] | None = None
        self.said = page.gui.add_html(sentence(said))

    def withdraw(self) -> None:
        """Take back the offer to replace a file: what would be written is another one now."""
        self._confirmed, self.replace.visible = None, False

    def _confirm(self) -> None:
        if self._confirmed is not None:
            self._confirmed()

    def _write(self, suffix: str, write: Callable[[Path], str], confirmed: str = "") -> None:
        name = f"{self.name.value}{suffix}"
        self.withdraw()
        try:
            said = write(self._output.path_for(name, replace=name == confirmed))
        except Rx90Error as error:
            if isinstance(error, ExistingFileError):
                self._confirmed, self.replace.visible = partial(self._write, suffix, write, name), True
            self.said.content = sentence(str(error), wrong=True)
        else:
            self.said.content = sentence(said)


class NewestOnly(Generic[_Item]):
    """Hands the newest of what it is given to a function, on a thread of its own.

    Args:
        page: on whose thread `give` is called.
        work: what is done with an item; may take its time, the next one waits for it. What it returns is called on the
            page's thread, unless something newer was given in the meantime.
        interval: the shortest time from one call to the next, s.
    """

    def __init__(self, page: Page, work: Callable[[_Item], Callable[[], None] | None], interval: float) -> None:
        self._page, self._work, self._interval = page, work, interval
        self._changed = threading.Condition()
        self._waiting: list[tuple[int, _Item]] = []
        self._given = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="newest", daemon=True)
        self._thread.start()

    def give(self, item: _Item) -> None:
        """Have `item` worked on, in place of one that still waits; returns at once."""
        with self._changed:
            self._given += 1
            self._waiting[:] = [(self._given, item)]
            self._changed.notify()

    def close(self) -> None:
        """Drop what waits, and end the thread after what it works on, which may last longer than this waits."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(_THREAD_END)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or bool(self._waiting))
                if self._closed:
                    return
                number, item = self._waiting.pop()
            show = self._work(item)
            if show is not None:
                self._page.later(partial(self._show, number, show))
            with self._changed:
                self._changed.wait_for(lambda: self._closed, self._interval)

    def _show(self, number: int, show: Callable[[], None]) -> None:
        if number == self._given:
            show()
