"""Problem families of all installed packages, found through the entry-point group ``trajopt.problems``.

Each entry names a module with ``families() -> dict[str, Family]``; the library imports none by name.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, cast

from trajopt.errors import InputError, TrajoptError

if TYPE_CHECKING:
    from trajopt.family import Family
    from trajopt.robot import Robot

GROUP = "trajopt.problems"


def families() -> dict[str, Family]:
    """Return all families by name, sorted; a package that cannot be loaded is left out with a warning.

    Raises `TrajoptError` when there is none, or when two packages use one name.
    """
    found: dict[str, Family] = {}
    origin: dict[str, str] = {}
    for entry in {entry.value: entry for entry in entry_points(group=GROUP)}.values():
        for name, family in _families_of(entry).items():
            if name in found:
                raise TrajoptError(f"problem '{name}' is offered by both {origin[name]} and {entry.value}")
            found[name], origin[name] = family, entry.value
    if not found:
        raise TrajoptError(
            f"no problem families are installed: no usable entry point in the group '{GROUP}'; "
            "install the package that offers them again"
        )
    return dict(sorted(found.items()))


def problem_modules() -> tuple[str, ...]:
    """The modules of all packages that this process has loaded, for others to load."""
    return tuple(entry.module for entry in entry_points(group=GROUP) if entry.module in sys.modules)


def robot(name: str) -> Robot:
    """The robot of that name, or of a ``.py`` file that builds one.

    A package's module may offer ``robot(name) -> Robot``, which raises InputError for a name that it does not
    know: so does this where none of them knows it. A package that cannot be loaded is passed over.
    """
    found = _asked("robot", name)
    if found is None:
        raise InputError(f"robot '{name}' is unknown", "an installed package that offers robots")
    return cast("Robot", found)


def robot_kind(name: str) -> str | None:
    """Kind of a robot by name, or of a ``.py`` file that builds one; None where no package knows robots.

    A package's module may offer ``robot_kind(name) -> str``, which raises InputError for a name that it does
    not know: so does this where none of them knows it. A package that cannot be loaded is passed over.
    """
    found = _asked("robot_kind", name)
    return None if found is None else str(found)


def _asked(question: str, name: str) -> object:
    """The first answer of a package that has a function of that name; None where none has one."""
    unknown: InputError | None = None
    for entry in entry_points(group=GROUP):
        try:
            offered = getattr(entry.load(), question, None)
        except Exception:  # `families` warns of it
            continue
        try:
            if offered is not None:
                return cast(object, offered(name))
        except InputError as error:
            unknown = unknown or error
    if unknown is not None:
        raise unknown
    return None


def _families_of(entry: EntryPoint) -> Mapping[str, Family]:
    try:
        offered: Mapping[str, Family] = entry.load().families()
    except Exception as error:  # whatever a foreign package raises must not take the others down
        reason = f"{type(error).__name__}: {error}"
        warnings.warn(f"problems of '{entry.value}' cannot be loaded: {reason}", stacklevel=3)
        return {}
    return offered
