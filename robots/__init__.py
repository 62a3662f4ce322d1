"""Robots by name: one file a robot, each with ``build() -> Robot``."""

from __future__ import annotations

import importlib
import pkgutil

from trajopt.errors import InputError
from trajopt.robot import Robot


def names() -> tuple[str, ...]:
    """Return the names of all robots of this package, sorted."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def load(name: str) -> Robot:
    """Return the robot of that name; raises `InputError` that lists the known names."""
    if name not in names():
        raise InputError(f"robot '{name}' is unknown", "one of " + ", ".join(names()))
    robot: Robot = importlib.import_module(f"{__name__}.{name}").build()
    return robot
