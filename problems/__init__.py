"""Problems by name: modules of families, each with a ``FAMILY`` or several ``FAMILIES``."""

import importlib
import pkgutil
from functools import lru_cache

from trajopt.problem import Family, Problem, PublishedOptimum, choose
from trajopt.robot import Robot
from trajopt_library import robots


@lru_cache(maxsize=1)
def families() -> dict[str, Family]:
    """All families by name."""
    modules = [
        importlib.import_module(f"{__name__}.{info.name}")
        for info in pkgutil.iter_modules(__path__)
        if not info.name.startswith("_")
    ]
    families = [module.FAMILY for module in modules if hasattr(module, "FAMILY")]
    families += [family for module in modules for family in getattr(module, "FAMILIES", ())]
    return {family.name: family for family in sorted(families, key=lambda family: family.name)}


def family(name: str) -> Family:
    """The family of that name; raises `InputError` that lists the known names."""
    return choose(families(), name)


def published() -> tuple[PublishedOptimum, ...]:
    """Problems with published optima, for ``trajopt bench outside``."""
    return importlib.import_module(f"{__name__}._published").optima()


def robot_kind(name: str) -> str:
    """Kind of a robot, by name or file: what families it may suit. Raises `InputError` for an unknown one."""
    return robots.kind(name)


def robot(name: str) -> Robot:
    """The robot of that name or file. Raises `InputError` for an unknown one."""
    return robots.load(name)


def load(name: str, **parameters: object) -> Problem:
    """Build the problem of that name, for example ``load("solo12-jump", distance=0.3)``."""
    return family(name).load(parameters)
