"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable

#: Reports progress: cases done, cases in all, what is being worked on.
Progress = Callable[[int, int, str], None]
