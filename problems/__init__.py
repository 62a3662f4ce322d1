"""Problems by name: modules of families, each with a ``FAMILY`` or several ``FAMILIES``."""

import importlib
import pkgutil
from collections.abc import Sequence
from functools import lru_cache
from itertools import takewhile

from trajopt.problem import Family, Problem, PublishedOptimum, choose
from trajopt.robot import Robot
from trajopt_library import robots


@lru_cache(maxsize=1)
def families() -> dict[str, Family]:
    """All families by name."""
    families = [family for module in _modules() for family in _families_in(module)]
    return {family.name: family for family in sorted(families, key=lambda family: family.name)}


def family(name: str) -> Family:
    """The family of that name, from the modules with names like it, so that few are loaded.

    Raises `InputError` that lists the known names.
    """

    def likeness(module: str) -> int:
        pairs = zip(module, name.replace("-", "_"), strict=False)
        return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))

    for module in sorted(_modules(), key=likeness, reverse=True):
        for family in _families_in(module):
            if family.name == name:
                return family
    return choose(families(), name)


@lru_cache(maxsize=1)
def _modules() -> tuple[str, ...]:
    return tuple(info.name for info in pkgutil.iter_modules(__path__) if not info.name.startswith("_"))


def _families_in(name: str) -> Sequence[Family]:
    module = importlib.import_module(f"{__name__}.{name}")
    return [module.FAMILY] if hasattr(module, "FAMILY") else getattr(module, "FAMILIES", ())


def published() -> tuple[PublishedOptimum, ...]:
    """Problems with published optima, for ``trajopt bench outside``."""
    return importlib.import_module(f"{__name__}._published").optima()


def robot_kind(name: str) -> str:
    """Kind of a robot, by name or file: what families it may suit. Raises `InputError` for an unknown one."""
    return robots.kind(name)


def robot_names() -> dict[str, tuple[str, ...]]:
    """Names of all robots by kind, and of those of installed packages."""
    return robots.by_group()


def robot(name: str) -> Robot:
    """The robot of that name or file. Raises `InputError` for an unknown one."""
    return robots.load(name)


def load(name: str, **parameters: object) -> Problem:
    """Build the problem of that name, for example ``load("solo12-jump", distance=0.3)``."""
    return family(name).load(parameters)
