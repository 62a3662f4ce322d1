"""Versions of installed packages: wheels that the extension was compiled against, and optional packages."""

import importlib
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType

from trajopt.errors import InputError, VersionMismatchError

# Name of the distribution of this package.
DISTRIBUTION = "trajopt-contacts"


@lru_cache
def installed_version(name: str) -> str:
    """Return the version of a distribution, or ``"none"``; this package is ``trajopt``."""
    try:
        return version(DISTRIBUTION if name == "trajopt" else name)
    except PackageNotFoundError:
        return "none"


def optional_package(name: str, *, what: str = "this", extra: str = "") -> ModuleType:
    """Return the module ``name`` of an optional package; raises `InputError` if it is not installed.

    ``what`` names what needs it, in the message; ``extra`` is an extra of this project that installs it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        advice = f"pip install {package}" + (f", or the extra '{extra}'" if extra else "")
        raise InputError(f"{what} needs {package}, which is not installed", advice) from None


def check_versions(needed: Mapping[str, str]) -> None:
    """Raise `VersionMismatchError` unless the installed wheels have the ``needed`` versions by name.

    The one-line message states the installed and needed versions and the command to install them.
    """
    wrong = {name: wanted for name, wanted in needed.items() if installed_version(name) != wanted}
    if not wrong:
        return
    installed = ", ".join(f"{name} {installed_version(name)}" for name in wrong)
    wanted = ", ".join(f"{name} {version}" for name, version in wrong.items())
    pins = " ".join(f"{name}=={version}" for name, version in wrong.items())
    raise VersionMismatchError(
        f"installed: {installed}; trajopt was compiled against {wanted}; run: pip install {pins}"
    )


def check_installation() -> None:
    """Check the wheels against those recorded when the extension was compiled.

    ``pin`` and ``coal`` are the Python parts of ``libpinocchio`` and ``libcoal``, with the same versions.
    """
    from trajopt._built_against import BUILT_AGAINST

    pairs = {"pin": "libpinocchio", "coal": "libcoal"}
    check_versions({**BUILT_AGAINST, **{name: BUILT_AGAINST[other] for name, other in pairs.items()}})


VERSIONED = ("trajopt", "casadi", "pin", "numpy")
