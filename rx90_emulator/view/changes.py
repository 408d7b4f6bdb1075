"""Fields that the page and its users both change: a user's change is never lost to one of the page's own."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from viser import GuiInputHandle

from rx90_emulator.view.page import Page

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
