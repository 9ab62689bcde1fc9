"""Which page shows which figure, and the command that the page says made it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_IMAGE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+\.(?:svg|png))\)")
#: A command as a line of a code block or in running text; `make` stands for the verb of its name.
_COMMAND = re.compile(r"(?:^|`)((?:mantis|make) [a-z][^`#\n]*)", re.MULTILINE)


@dataclass(frozen=True)
class Figure:
    """A figure and its caption; the path is relative to the folder of the pages."""

    path: str
    caption: str


@dataclass(frozen=True)
class Page:
    """A page with figures: its path, title, the command it states first, and its figures in order."""

    path: str
    title: str
    command: str
    figures: tuple[Figure, ...]


def by_page(docs: Path) -> list[Page]:
    """Pages directly in a folder that show figures, by title."""
    pages = []
    for path in sorted(set(docs.glob("*.md")) - {docs / "index.md"}):
        text = path.read_text(encoding="utf-8")
        figures = tuple(Figure(target, " ".join(caption.split())) for caption, target in _IMAGE.findall(text))
        command, title = _COMMAND.search(text), re.search(r"^# (.*)", text, re.MULTILINE)
        if figures and title:
            pages.append(Page(path.name, title[1], command[1].strip() if command else "", figures))
    return sorted(pages, key=lambda page: page.title)
