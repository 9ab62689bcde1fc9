"""Mitsuba in its LLVM variant, for the tests that render."""

from __future__ import annotations

from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def mi() -> ModuleType:
    """Mitsuba with an LLVM variant set; skips where no libLLVM can be had."""
    from scenes.llvm import LLVM_VARIANT, activate_variant

    if activate_variant() != LLVM_VARIANT:
        pytest.skip("needs a libLLVM that Dr.Jit can use (see `mantis doctor`)")
    import mitsuba

    return mitsuba
