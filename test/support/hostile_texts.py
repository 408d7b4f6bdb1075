"""Texts that HTML, Markdown, a template or a formula would take for more than text, and files made of them."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import yaml
from browser import BrowserPage
from report_pages import ReportPage

from rx90_common.description.robot_files import FILES, RobotFiles

TEXTS = (
    "<script>window.ran = 1</script>",
    '<img src="http://marker.invalid" onerror="window.ran = 1">',
    '"\' onmouseover=window.ran=1 onfocus=window.ran=1 autofocus x="><b>',
    "``` <iframe srcdoc='<script>top.ran = 1</script>'></iframe>",
    "![x](http://marker.invalid) [y](javascript:window.ran=1)",
    "]]> --> </script></style> {{7*7}} {% x %} $x_ $$\\frac12$$ %s @y &amp;",
)
"""One for each joint of an arm."""
JOINTS = {f"joint_{k}": text for k, text in enumerate(TEXTS, 1)}
_KEPT = {"base_link", "tool0"}  # which the tool is attached to
_ROOTS = """() => {
    const roots = [document];
    for (const root of roots)
        for (const part of root.querySelectorAll('*')) if (part.shadowRoot) roots.push(part.shadowRoot);
"""
_SHOWN = f"{_ROOTS} return roots.flatMap(root => [...root.children].map(part => part.innerText)).join('\\n'); }}"
_FOUND = (
    _ROOTS
    + """
    const bad = 'img:not([src^="data:"]), iframe, object, embed, [href^="javascript"], [onerror], [onmouseover]';
    const made = roots.flatMap(root => [...root.querySelectorAll(bad)].map(part => part.outerHTML));
    return window.ran ? [...made, 'a script ran'] : made;
}"""
)


def hostile(content: Any) -> Any:
    if isinstance(content, dict):
        return {
            JOINTS.get(key, key): "\n".join(TEXTS) if key in ("source", "note") else hostile(value)
            for key, value in content.items()
        }
    if isinstance(content, list):
        return [hostile(part) for part in content]
    return JOINTS.get(content, content) if isinstance(content, str) else content


def hostile_robot(folder: Path, task: Path) -> RobotFiles:
    files = RobotFiles()
    tree = ET.parse(files.urdf)
    for part in tree.iter():
        for key in ("name", "link", "filename"):
            if key in part.attrib and part.attrib[key] not in _KEPT:
                part.attrib[key] = JOINTS.get(part.attrib[key], part.attrib[key] + TEXTS[0])
    tree.write(folder / "robot.urdf")
    for role in FILES:
        source = task if role == "task" else getattr(files, role)
        if role != "urdf" and source is not None:
            content = hostile(yaml.safe_load(source.read_text(encoding="utf-8")))
            (folder / f"{role}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return RobotFiles.named(str(folder))


def check_harmless(shown: BrowserPage | ReportPage, *visible: str) -> None:
    """Fail if a page runs or builds anything out of a text, asks for anything elsewhere, or does not show a text."""
    made = shown.page.evaluate(_FOUND)
    assert made == [], made
    text = shown.page.evaluate(_SHOWN)
    hidden = [part for part in visible if part not in text]
    assert hidden == [], text
