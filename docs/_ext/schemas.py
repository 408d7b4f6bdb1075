"""The directive `schemas`: the JSON schemas of config/schemas/, each with its keys."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

FOLDER = Path(__file__).resolve().parents[2] / "config/schemas"


class Schemas(SphinxDirective):
    """Lists the schemas."""

    def run(self) -> list[nodes.Node]:
        """Return a list of the schemas, each with what its title or description says."""
        files = sorted(FOLDER.glob("*.json"))
        if not files:
            text = "There are no JSON schemas yet; each command refuses what a file must not hold."
            return [nodes.paragraph("", text)]
        listing = nodes.bullet_list()
        for file in files:
            self.env.note_dependency(str(file))
            listing += nodes.list_item(
                "", self._entry(file.name, json.loads(file.read_text(encoding="utf-8")))
            )
        return [listing]

    def _entry(self, name: str, schema: dict[str, Any]) -> nodes.paragraph:
        about = schema.get("description") or schema.get("title") or ""
        keys = ", ".join(schema.get("properties", {}))
        text = f": {about}" + f" Keys: {keys}." * bool(keys)
        return nodes.paragraph(
            "", "", nodes.literal("", f"config/schemas/{name}"), nodes.Text(text)
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("schemas", Schemas)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
