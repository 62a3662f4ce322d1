"""Robots of all installed packages, by name, found through the entry-point group ``trajopt.problems``.

An entry names a module; a module with ``robot(name) -> Robot`` and ``robot_kind(name) -> str`` offers robots,
and ``robot_names() -> dict[str, tuple[str, ...]]`` lists them, by kind.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, cast

from trajopt.arguments import checked
from trajopt.errors import InputError, VersionMismatchError

if TYPE_CHECKING:
    from trajopt.robot.robot import Robot

GROUP = "trajopt.problems"


def offers(group: str) -> tuple[EntryPoint, ...]:
    """Entry points of a group in all installed packages, one for each module."""
    return _offers(group, tuple(sys.path))


@lru_cache
def _offers(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """The entry points found on the module path; cached, as reading all metadata takes 10 ms."""
    return tuple({entry.value: entry for entry in entry_points(group=group)}.values())


@checked
def robot(name: str) -> Robot:
    """The robot of that name, of a ``.py`` file that builds one, or of a package, as ``PACKAGE:NAME``.

    A package's module may offer ``robot(name) -> Robot``, which raises InputError for an unknown name; this
    function raises it if no package knows the name. A package that cannot be loaded is skipped.
    """
    loaded = _from_packages("robot", name)
    if loaded is None:
        raise InputError(f"robot '{name}' is unknown", "an installed package that offers robots")
    return cast("Robot", loaded)


def robot_kind(name: str) -> str | None:
    """Kind of a robot by name, or of a ``.py`` file that builds one; None where no package offers robots.

    A package's module may offer ``robot_kind(name) -> str``, which raises InputError for an unknown name;
    this function raises it if no package knows the name. A package that cannot be loaded is skipped.
    """
    kind = _from_packages("robot_kind", name)
    return None if kind is None else str(kind)


def kind_if_known(name: str) -> str | None:
    """Kind of a robot by name; None if no package offers it."""
    try:
        return robot_kind(name)
    except InputError:
        return None


def robot_names() -> dict[str, list[str]]:
    """Names of the robots of all packages by kind, or under the form that they have, as ``PACKAGE:NAME``."""
    known: dict[str, list[str]] = {}
    for offered in _offered("robot_names"):
        for group, names in offered().items():
            known.setdefault(group, []).extend(names)
    return known


def is_packaged(name: str) -> bool:
    """Whether a robot's name has the form ``PACKAGE:NAME``, of a description in another package."""
    return ":" in name and not name.endswith((".py", ":rolling"))


def _from_packages(function: str, name: str) -> object:
    """First result of the packages' functions of that name; None if no package has such a function."""
    unknown: InputError | None = None
    for offered in _offered(function):
        try:
            return cast(object, offered(name))
        except InputError as error:
            unknown = unknown or error
    if unknown is not None:
        raise unknown
    return None


def _offered(function: str) -> Iterator[Callable[..., Any]]:
    """The functions of that name of the packages that have one and can be loaded."""
    for entry in offers(GROUP):
        try:
            found = getattr(entry.load(), function, None)
        except VersionMismatchError:
            raise
        except Exception:  # `families` warns of it
            continue
        if found is not None:
            yield found
