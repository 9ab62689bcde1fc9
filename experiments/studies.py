"""The verbs of the thesis's other studies."""

from __future__ import annotations

VERBS: tuple = ()
