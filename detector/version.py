"""Which detector made a result."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable


@cache
def code_version() -> str:
    """Hash of this package's source, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for name, text in sorted(_sources(files("detector"), "")):
        digest.update(name.encode() + text)
    return digest.hexdigest()[:16]


def _sources(folder: Traversable, prefix: str) -> Iterator[tuple[str, bytes]]:
    """Path within the package, and text, of every module in a folder and the folders below it."""
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _sources(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".py"):
            yield prefix + entry.name, entry.read_bytes()
