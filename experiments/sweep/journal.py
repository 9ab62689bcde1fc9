"""A journal of finished cases: one checked line each, appended and flushed to disk, so that no interruption loses any."""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from typing import Any

from scenes.atomic import atomic_write

Record = dict[str, Any]


class Journal:
    """Finished cases of one piece of work, told apart by its digest.

    A line is a CRC-32 and JSON. Floats are written so that they read back bit for bit. Lines that an interruption cut
    short fail their check and are dropped.
    """

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest

    def open(self, resume: bool) -> dict[int, Record]:
        """Records by case of an interrupted run, or none after starting a new journal.

        Raises:
            ValueError: when there is a journal and `resume` is not set, or it belongs to other work.
        """
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._write([("work", self.digest)], "w")
            return {}
        lines = list(self._valid_lines())
        if not lines or lines[0] != ["work", self.digest]:
            raise ValueError(f"{self.path}: belongs to another sweep; remove it or choose another --out")
        if not resume:
            raise ValueError(
                f"{self.path}: an unfinished run of this sweep; add --resume, or remove the file to start anew"
            )
        records = {int(index): record for index, record in lines[1:]}
        # Written anew, so that a half line at the end does not spoil the next one appended.
        with atomic_write(self.path) as temporary:
            temporary.write_text("".join(self._line(entry) for entry in lines), encoding="utf-8")
        return records

    def append(self, index: int, record: Record) -> None:
        """Add a finished case; on disk when this returns."""
        self._write([(index, record)], "a")

    def remove(self) -> None:
        """The work is done and its result written."""
        self.path.unlink(missing_ok=True)

    def _write(self, entries: list[tuple[Any, Any]], mode: str) -> None:
        with self.path.open(mode, encoding="utf-8") as file:
            file.writelines(self._line(entry) for entry in entries)
            file.flush()
            os.fsync(file.fileno())

    def _valid_lines(self) -> list[list[Any]]:
        valid = []
        for line in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
            check, _, text = line.partition(" ")
            if check != f"{zlib.crc32(text.encode()):08x}":
                break
            valid.append(json.loads(text))
        return valid

    @staticmethod
    def _line(entry: Any) -> str:
        text = json.dumps(entry)
        return f"{zlib.crc32(text.encode()):08x} {text}\n"
