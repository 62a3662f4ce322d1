"""Problem families of all installed packages, found through the entry-point group ``trajopt.problems``.

Each entry names a module with ``families() -> dict[str, Family]``, and ``family(name) -> Family`` if that is
faster; the library imports none by name.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, cast

from trajopt.arguments import checked
from trajopt.errors import InputError, TrajoptError, VersionMismatchError, in_file
from trajopt.robot.catalogue import GROUP, offers

if TYPE_CHECKING:
    from trajopt.problem.family import Family
    from trajopt.problem.problem import Problem
    from trajopt.problem.published import PublishedOptimum


@checked
def families() -> dict[str, Family]:
    """Return all families by name, sorted; a package that cannot be loaded is left out with a warning.

    Raises `TrajoptError` when there is none, or when two packages use the same name.
    """
    known: dict[str, Family] = {}
    origin: dict[str, str] = {}
    for entry in offers(GROUP):
        for name, family in _families_of(entry).items():
            if name in known:
                raise TrajoptError(f"problem '{name}' is offered by both {origin[name]} and {entry.value}")
            known[name], origin[name] = family, entry.value
    if not known:
        raise TrajoptError(
            f"no problem families are installed: no usable entry point in the group '{GROUP}'; "
            "install the package that offers them again"
        )
    return dict(sorted(known.items()))


@checked
def family(name: str) -> Family:
    """The family of that name; where one package alone offers any, its others are not loaded.

    Raises `InputError` that lists the known names.
    """
    from trajopt.problem.family import choose

    only, *others = (*offers(GROUP), None)
    if only is not None and others == [None]:
        try:
            return cast("Family", only.load().family(name))
        except (InputError, VersionMismatchError):
            raise
        except Exception:  # `families` warns of it
            pass
    return choose(families(), name)


def _families_of(entry: EntryPoint) -> Mapping[str, Family]:
    try:
        offered: Mapping[str, Family] = entry.load().families()
    except VersionMismatchError:
        raise
    except Exception as error:  # an error in one package must not affect the others
        reason = in_file(error)
        warnings.warn(f"problems of '{entry.value}' cannot be loaded: {reason}", stacklevel=3)
        return {}
    return offered


def published_optima() -> tuple[PublishedOptimum, ...]:
    """Return the problems with published optima of all packages that have some."""
    modules = [entry.load() for entry in offers(GROUP)]
    return tuple(one for module in modules if hasattr(module, "published") for one in module.published())


def problem_modules() -> tuple[str, ...]:
    """Return the modules of all packages that this process has loaded, for other processes to load."""
    return tuple(entry.module for entry in offers(GROUP) if entry.module in sys.modules)


@checked
def load(name: str, **parameters: object) -> Problem:
    """Build the problem of that name, as ``load("solo12-jump", distance=0.3)``. Raises `InputError`."""
    return family(name).load(parameters)
