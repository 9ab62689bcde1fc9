"""Mantis in a notebook or a script: ``import mantis``. It holds the functions of `experiments.api`, and nothing else."""

import sys
from importlib.util import find_spec
from pathlib import Path


def _check_own_packages() -> None:
    """Refuse to go on where a package of another project stands before one of this project's on the import path."""
    home = Path(__file__).resolve().parent
    for name in ("radiometry", "materials", "scenes", "detector", "experiments"):
        spec = find_spec(name)
        places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        found = next((Path(place).resolve() for place in places if place), None)
        if found is None or home / name not in (found, found.parent):
            raise ImportError(f"mantis: {found or 'nothing'} hides the package {name} of {home}; rename or move it")


_check_own_packages()

from experiments.api import *  # noqa: E402, F403
from experiments.api import __all__ as __all__  # noqa: E402

if "IPython" in sys.modules:
    from experiments.reporting.notebook import register

    register()  # results show themselves as tables and pictures
