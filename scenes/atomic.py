"""Writing files so that they appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it onto `path` when the block succeeds, and remove it when the block fails.

    The parent folder is created. The temporary name keeps the suffix, because many writers choose their format by it.

    Args:
        path: of the file to write.

    Raises:
        IsADirectoryError: when the path is a folder.
        OSError: when the file cannot be written; it names `path`, not the temporary file.
    """
    path = Path(path)
    if path.is_dir():  # else the temporary name would be blamed
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename in (
            None,
            str(temporary),
        ):  # writing, unlike opening, does not say what; the name would mean nothing
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
