"""What the forms share: text as the panel shows it."""

from __future__ import annotations

import html


def block(content: str) -> str:
    """Return HTML as the panel shows text: small, and broken where it is too wide."""
    return f'<div style="padding:0 0.6em;font-size:0.8em;overflow-wrap:anywhere">{content}</div>'


def sentence(text: str, *, wrong: bool = False) -> str:
    """Return a sentence as HTML; of a refusal in red."""
    return block(f'<div style="color:{"#c92a2a" if wrong else "inherit"}">{html.escape(text)}</div>')
