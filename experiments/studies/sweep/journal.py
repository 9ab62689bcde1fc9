"""A journal of finished cases: one checked line each, appended and flushed to disk, so that no interruption loses any."""

from __future__ import annotations

import fcntl
import json
import os
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

Record = dict[str, Any]

#: Bytes; what is longer and has no whole line was never a journal.
_LONGEST_FIRST_LINE = 200


class Journal:
    """Finished cases of one piece of work, told apart by its digest.

    A line is a CRC-32 and JSON. Floats are written so that they read back bit for bit. Lines that an interruption cut
    short fail their check and are dropped. One process at a time may have a journal open.
    """

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest
        self._file: IO[str] | None = None
        self._empty = False  # of cases, and begun by this run

    def open(self, resume: bool) -> dict[int, Record]:
        """Records by case of an interrupted run, or none after starting a new journal.

        Raises:
            ValueError: when there is a journal and `resume` is not set, or it belongs to other work, or is at work now.
            OSError: when it cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("a+", encoding="utf-8", errors="replace", newline="")
        try:
            return self._locked(self._file, resume)
        except BaseException:
            self.close()
            raise

    def append(self, finished: Sequence[tuple[int, Record]]) -> None:
        """Add finished cases; on disk when this returns.

        Raises:
            OSError: when they cannot be written, with the journal's name; those before are kept.
        """
        self._write(finished)
        self._empty = False

    def close(self) -> None:
        """Leave the journal for a later run; where it holds no case, none is left."""
        if self._file is not None:
            if self._empty:
                self.path.unlink(missing_ok=True)
            file, self._file = self._file, None
            with suppress(OSError):  # a full disk, told of before, leaves characters in the buffer
                file.close()

    def remove(self) -> None:
        """The work is done and its result written."""
        self.path.unlink(missing_ok=True)
        self.close()

    def _locked(self, file: IO[str], resume: bool) -> dict[int, Record]:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process, however that ends
        except BlockingIOError:
            raise ValueError(f"{self.path}: this sweep is running; wait for it, or choose another --out") from None
        file.seek(0)
        entries, whole = [], 0
        for line in file:
            entry = _entry(line)
            if entry is None:
                break
            entries.append(entry)
            whole += len(line.encode())
        if not entries and self.path.stat().st_size > _LONGEST_FIRST_LINE:
            raise ValueError(f"{self.path}: not a sweep's journal; remove it or choose another --out")
        # What follows the last whole line would spoil the next one appended.
        file.truncate(whole)
        if len(entries) < 2:  # new, or ended before the first case
            file.truncate(0)
            self._write([("work", self.digest)])
            self._empty = True
            return {}
        if entries[0] != ["work", self.digest]:
            raise ValueError(
                f"{self.path}: belongs to another sweep, or to this one under other software; remove it or choose another --out"
            )
        if not resume:
            raise ValueError(
                f"{self.path}: an unfinished run of this sweep; add --resume, or remove the file to start anew"
            )
        return {int(index): record for index, record in entries[1:]}

    def _write(self, entries: Iterable[tuple[Any, Any]]) -> None:
        assert self._file is not None, "the journal is not open"
        try:
            self._file.write("".join(_line(entry) for entry in entries))
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            error.filename = str(self.path)
            raise


def _line(entry: Any) -> str:
    text = json.dumps(entry)
    return f"{zlib.crc32(text.encode()):08x} {text}\n"


def _entry(line: str) -> Any:
    """What a line holds, None where it is not whole."""
    check, _, text = line.rstrip("\n").partition(" ")
    return json.loads(text) if line.endswith("\n") and check == f"{zlib.crc32(text.encode()):08x}" else None
