"""Problem families of all installed packages, found through the entry-point group ``trajopt.problems``.

Each entry names a module with ``families() -> dict[str, Family]``, and ``family(name) -> Family`` if that is
faster; the library imports none by name.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from trajopt.arguments import checked
from trajopt.cache import read_entry, write_entry
from trajopt.errors import InputError, TrajoptError, VersionMismatchError, in_file
from trajopt.problem.family import Family, choose
from trajopt.robot.catalogue import GROUP, kind_if_known, offers

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem, PublishedOptimum


@checked
def families() -> dict[str, Family]:
    """Return all families by name, sorted; a package that cannot be loaded is left out with a warning.

    Raises `TrajoptError` when there is none, when the only package cannot be loaded, or when two packages use
    the same name.
    """
    known: dict[str, Family] = {}
    origin: dict[str, str] = {}
    entries = offers(GROUP)
    for entry in entries:
        offered: Mapping[str, Family] = {}
        try:
            with _loading(entry):
                offered = entry.load().families()
        except TrajoptError as error:  # one package's error must not affect the others
            if len(entries) == 1 or isinstance(error, VersionMismatchError):
                raise
            warnings.warn(str(error), stacklevel=2)
        for name, family in offered.items():
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
    """The family of that name; if only one package offers families, the others are not loaded.

    Raises `InputError` that lists the known names, or `TrajoptError` if that package cannot be loaded.
    """
    entries = offers(GROUP)
    if len(entries) == 1:
        with _loading(entries[0], InputError):
            module = entries[0].load()
            if hasattr(module, "family"):
                return cast("Family", module.family(name))
    return choose(families(), name)


@contextlib.contextmanager
def _loading(entry: EntryPoint, *passed: type[Exception]) -> Iterator[None]:
    """Turn errors into a `TrajoptError` that names the package, except version mismatches and ``passed``."""
    try:
        yield
    except Exception as error:
        if isinstance(error, (VersionMismatchError, *passed)):
            raise
        raise TrajoptError(f"problems of '{entry.value}' cannot be loaded: {in_file(error)}") from error


def listing() -> tuple[dict[str, Family], dict[str, str]]:
    """All `families`, to be listed rather than built, and the kinds of their robots.

    They are read from the cache unless a module that was loaded for them, or its folder, has changed since.
    """
    begun, entries = time.time_ns(), offers(GROUP)
    key = repr((sys.path, [entry.value for entry in entries]))
    name = f"listing.{hashlib.sha256(key.encode()).hexdigest()[:32]}"
    loaded = any(entry.module in sys.modules for entry in entries)
    content = None if loaded else read_entry(name)
    if content is not None:
        with contextlib.suppress(OSError):  # a file that is gone
            states, shown, kinds = json.loads(content, object_hook=lambda fields: SimpleNamespace(**fields))
            if all(_state(place) == before for place, before in states):
                return {each.name: each for each in shown}, dict(kinds)
    with warnings.catch_warnings(record=True) as warned:
        known = families()
        kinds = {each.robot: kind for each in known.values() if (kind := kind_if_known(each.robot))}
    for each in warned:
        warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    files = {file for module in list(sys.modules.values()) if (file := getattr(module, "__file__", None))}
    with contextlib.suppress(OSError):  # a module in an archive
        places = sorted(files | set(map(os.path.dirname, files)))
        states = [(place, _state(place)) for place in places]
        if not (loaded or warned) and all(isinstance(now, str) or now < begun for _, now in states):
            kept = states, list(known.values()), list(kinds.items())
            write_entry(name, json.dumps(kept, default=_fields).encode())
    return known, kinds


def _state(place: str) -> int | str:
    """Modification time of a file in ns, or names of the modules and packages in a folder."""
    if not os.path.isdir(place):
        return os.stat(place).st_mtime_ns
    inside = (name for name in os.listdir(place) if name.endswith(".py") or "." not in name)
    return " ".join(sorted(name for name in inside if name != "__pycache__"))


def _fields(thing: Any) -> dict[str, Any] | None:
    """Fields of a family or parameter that are listed; None for a function."""
    if callable(thing):
        return None
    family = isinstance(thing, Family)
    names = ("takes_robot", "tested") if family else ("name", "meaning", "unit", "lower", "upper")
    stated = {name: value for name, value in vars(thing).items() if name != "variants"}  # in `tested`
    return {name: getattr(thing, name) for name in names} | stated


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
