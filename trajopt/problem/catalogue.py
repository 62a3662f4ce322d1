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
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any, cast

from trajopt.arguments import checked
from trajopt.cache import read_entry, write_entry
from trajopt.errors import InputError, TrajoptError, VersionMismatchError, in_file
from trajopt.problem.family import Choice, Family, Parameter, RobotName, choose
from trajopt.robot.catalogue import GROUP, kind_if_known, offers

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem
    from trajopt.problem.published import PublishedOptimum


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
        except TrajoptError as error:  # in one package must not affect the others
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
    """The family of that name; where one package alone offers any, its others are not loaded.

    Raises `InputError` that lists the known names, `TrajoptError` where that package cannot be loaded.
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
    """Errors of a package become a `TrajoptError` that names it, but for those that are passed on."""
    try:
        yield
    except Exception as error:
        if isinstance(error, (VersionMismatchError, *passed)):
            raise
        raise TrajoptError(f"problems of '{entry.value}' cannot be loaded: {in_file(error)}") from error


def listing() -> tuple[dict[str, Family], dict[str, str]]:
    """The families, as `families`, to be shown rather than built, and the kinds of their robots.

    It is found in the cache where no problems are loaded and no file has been added, removed or changed in
    any folder of a module that was loaded for it.
    """
    begun, entries = time.time_ns(), offers(GROUP)
    loaded = any(entry.module in sys.modules for entry in entries)
    key = repr((sys.path, [entry.value for entry in entries]))
    name = f"listing.{hashlib.sha256(key.encode()).hexdigest()[:32]}"
    with contextlib.suppress(OSError):  # a folder that is gone
        if not loaded and (content := read_entry(name)) is not None:
            folders, digest, listed = json.loads(content)
            if _state(folders)[0] == digest:
                known, kinds = json.loads(listed, object_hook=_restored)
                return dict(known), dict(kinds)
    try:
        with warnings.catch_warnings(record=True) as warned:
            known = families()
            kinds = {each.robot: kind for each in known.values() if (kind := kind_if_known(each.robot))}
    finally:
        for each in warned:
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    with contextlib.suppress(OSError, TypeError):  # a module in an archive; a value that JSON does not have
        if not (loaded or warned):
            digest, changed = _state(folders := _folders())
            items = [list(known.items()), list(kinds.items())]
            listed = json.dumps(items, default=lambda thing: None if callable(thing) else vars(thing))
            if changed < begun:  # else what was loaded may be older than the files
                write_entry(name, json.dumps((folders, digest, listed)).encode())
    return known, kinds


def _folders() -> list[str]:
    """Folders of the modules that are loaded, and all in the packages of families."""
    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    tops = [top for name in problem_modules() for top in getattr(sys.modules[name], "__path__", ())]
    inside = {folder for top in tops for folder, *_ in os.walk(top) if not folder.endswith("__pycache__")}
    return sorted(inside | {os.path.dirname(file) for file in files if file})


def _state(folders: Iterable[str]) -> tuple[str, int]:
    """Digest of what is in folders, by name, time of change and size, and the last of these times, ns."""
    inside = [each for folder in folders for each in os.scandir(folder) if each.name != "__pycache__"]
    stats = [(each.path, each.stat()) for each in inside if each.is_file()]
    files = sorted((path, stat.st_mtime_ns, stat.st_size) for path, stat in stats)
    text = repr((files, sorted(each.path for each in inside)))
    return hashlib.sha256(text.encode()).hexdigest(), max(changed for _, changed, _ in files)


def _restored(fields: dict[str, Any]) -> object:
    """The family or parameter with these fields, which were checked when it was made."""
    marks = {"phases": Family, "unit": Parameter, "name": Choice, "choices": RobotName}
    made: Any = object.__new__(next(kind for mark, kind in marks.items() if mark in fields))
    for name, value in fields.items():
        vars(made)[name] = tuple(value) if isinstance(value, list) else value
    return made


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
