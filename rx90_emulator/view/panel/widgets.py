"""What the forms share: text as the panel shows it, and changes by a user told from our own."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import TypeVar

from viser import GuiInputHandle

from rx90_emulator.view.page import Page

_Value = TypeVar("_Value")


def put(field: GuiInputHandle[_Value], value: _Value) -> None:
    """Show a value in a field."""
    field.value = value  # type: ignore[misc]  # viser's setter does not stand beside its getter


def block(content: str) -> str:
    """Return HTML as the panel shows text: small, and broken where it is too wide."""
    return f'<div style="padding:0 0.6em;font-size:0.8em;overflow-wrap:anywhere">{content}</div>'


def sentence(text: str, *, wrong: bool = False) -> str:
    """Return a sentence as HTML; of a refusal in red."""
    return block(f'<div style="color:{"#c92a2a" if wrong else "inherit"}">{html.escape(text)}</div>')


def from_user(callback: Callable[[], None], page: Page) -> Callable[[object], None]:
    """Return a callback of viser's that has `callback` called on the page's thread, for changes by a user alone."""

    def take(event: object) -> None:
        if getattr(event, "client_id", None) is not None:
            page.later(callback)

    return take
