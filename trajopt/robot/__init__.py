"""The robot: its model, contacts, limits and reference posture; actuators, stances and collision shapes.

The package is also the function that loads a robot from the catalogue: ``trajopt.robot("go2")``.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from trajopt.robot.robot import Robot

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _CallableRoom(ModuleType):
    """A package that can be called, because importing it makes ``trajopt.robot`` the package."""

    def __call__(self, name: str) -> Robot:
        """Return the robot of that name, ``.py`` file or ``PACKAGE:NAME``. Raises `InputError`."""
        from trajopt.robot.catalogue import robot

        return robot(name)


sys.modules[__name__].__class__ = _CallableRoom
