"""Packages that are not always installed, and the extra that installs them."""

from __future__ import annotations

import importlib
from types import ModuleType

from trajopt.errors import InputError


def package_of_extra(name: str, extra: str) -> ModuleType:
    """The module ``name`` of a package of an extra; raises `InputError` where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        own = name.partition(".")[0]
        raise InputError(
            f"this format needs {own}, which is not installed", f"pip install {own}, or the extra '{extra}'"
        ) from None
