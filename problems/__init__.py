"""Problems by name: one file a family, each with a ``FAMILY``."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import lru_cache

from trajopt.errors import InputError
from trajopt.family import Family
from trajopt.problem import Problem


@lru_cache(maxsize=1)
def families() -> dict[str, Family]:
    """All families by name."""
    modules = [importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__)]
    found = [module.FAMILY for module in modules if hasattr(module, "FAMILY")]
    return {family.name: family for family in sorted(found, key=lambda family: family.name)}


def family(name: str) -> Family:
    """The family of that name; raises `InputError` that lists the known names."""
    known = families()
    if name not in known:
        close = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise InputError(f"problem '{name}' is unknown", f"{hint}allowed: {', '.join(known)}")
    return known[name]


def load(name: str, **parameters: object) -> Problem:
    """Build the problem of that name, for example ``load("solo12-jump", distance=0.3)``."""
    return family(name).load(parameters)
