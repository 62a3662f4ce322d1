"""The wheels installed must be those the extension was compiled against."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from trajopt.errors import VersionMismatchError

# The distribution that holds this package.
DISTRIBUTION = "trajopt-contacts"


def installed_version(name: str) -> str:
    """Version of an installed distribution, or ``"none"``; of this package by its own name, ``trajopt``."""
    try:
        return version(DISTRIBUTION if name == "trajopt" else name)
    except PackageNotFoundError:
        return "none"


def check_versions(needed: Mapping[str, str]) -> None:
    """Compare the installed wheels with the ones needed.

    ``needed`` maps a distribution's name to the only version accepted. Raises
    ``VersionMismatchError`` with one line: what is installed, what is needed and the command
    that installs it.
    """
    wrong = {name: wanted for name, wanted in needed.items() if installed_version(name) != wanted}
    if not wrong:
        return
    found = ", ".join(f"{name} {installed_version(name)}" for name in wrong)
    wanted = ", ".join(f"{name} {version}" for name, version in wrong.items())
    pins = " ".join(f"{name}=={version}" for name, version in wrong.items())
    raise VersionMismatchError(
        f"installed: {found}; trajopt was compiled against {wanted}; run: pip install {pins}"
    )


def check_installation() -> None:
    """Check the wheels against those recorded when the extension was compiled.

    ``pin`` is the Python half of ``libpinocchio`` and must be of the same version.
    """
    from trajopt._built_against import BUILT_AGAINST

    check_versions({**BUILT_AGAINST, "pin": BUILT_AGAINST["libpinocchio"]})


VERSIONED = ("trajopt", "casadi", "pin", "numpy")
