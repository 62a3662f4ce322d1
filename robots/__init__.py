"""Robots by name: a file for each, with its ``KIND``, ``build() -> Robot`` and, for an arm, its ``TOOL``."""

import contextlib
import importlib
import importlib.util
import pkgutil
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from trajopt.errors import InputError, TrajoptError, failure, line_in, not_among, placed, shown
from trajopt.robot import Robot, feet_in_base
from trajopt.robot.catalogue import is_packaged
from trajopt_library.robots._packages import PACKAGES, packaged_as, packaged_file, packaged_names

KINDS = ("arm", "quadruped", "biped", "hopper", "pendulum", "multirotor")
# Kind of a robot with a free base by the number of its feet.
KIND_OF_FEET = {1: "hopper", 2: "biped", 4: "quadruped"}
# What messages offer beside the names.
OWN_FILE = "a .py file with build()"
# Suffix of a name or file for the same robot on rolling balls.
ROLLING = ":rolling"


def names(kind: str | None = None) -> tuple[str, ...]:
    """Return the names of all robots of this package, or of those of one of `KINDS`, sorted."""
    if kind is not None and kind not in KINDS:
        raise InputError(f"kind of robot '{kind}' is unknown", "one of " + ", ".join(KINDS))
    found = sorted(
        module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_")
    )
    return tuple(name for name in found if kind is None or kind == _module(name).KIND)


def by_group() -> dict[str, tuple[str, ...]]:
    """Return the names of all robots by kind, then those of installed packages under ``PACKAGE:NAME``."""
    groups = {kind: names(kind) for kind in KINDS}
    for package in PACKAGES:
        with contextlib.suppress(InputError):  # not installed
            groups[f"{package}:NAME"] = packaged_names(package)
    return groups


def load(name: str | Robot) -> Robot:
    """Return the robot of that name, or the one that ``build()`` of a .py file at that path returns.

    A robot is returned as it is. ``NAME:rolling`` is the robot with all contacts that have a radius rolling.
    ``PACKAGE:NAME`` is guessed from a description of another package, see `_packages`.
    Raises `InputError` for a name that is unknown (and lists the known ones), for a file that does not exist,
    cannot be read or does not build a `Robot`, and for ``:rolling`` of a robot without balls.
    """
    if isinstance(name, Robot):
        return name
    if name.endswith(ROLLING):
        return load(name.removesuffix(ROLLING)).with_rolling_contacts()
    if is_packaged(name):
        file = packaged_file(name)
        return _guessed(file, name.partition(":")[2], file.stat().st_mtime_ns)
    module = _module(name)
    try:
        robot = module.build()
    except TrajoptError as error:
        if name.endswith(".py"):
            raise placed(error, f"{name}, line {line_in(_file(module), error)}") from error
        raise
    except Exception as error:
        raise InputError(f"build() of {name} failed: {failure(error, _file(module))}") from error
    if not isinstance(robot, Robot):
        raise InputError(f"build() of {name} returns {type(robot).__name__}", "allowed: a Robot")
    return robot


def kind(name: str | Robot) -> str:
    """Return which of `KINDS` a robot is: its module's ``KIND``.

    A file at a path may leave it out, and a robot has none: a fixed base then makes an arm, feet a hopper
    (one), a biped (two) or a quadruped (four). Raises `InputError` for other numbers of feet, and as `load`.
    """
    given = _stated(name, "KIND")
    if given is not None:
        if given not in KINDS:
            raise InputError(f"KIND of {name} is {shown(given)}", "one of " + ", ".join(KINDS))
        return str(given)
    robot = load(name)
    if robot.base == "fixed":
        return "arm"
    standing = len(feet(robot))
    if standing not in KIND_OF_FEET:
        raise InputError(f"{robot.name} stands on {standing} feet", "KIND in the file, or 1, 2 or 4 feet")
    return KIND_OF_FEET[standing]


def tool_frame(name: str | Robot, loaded: Robot | None = None) -> str:
    """Return the name of an arm's tool frame: its module's ``TOOL``; ``loaded`` is the robot, if it is.

    A file at a path may leave it out, and a robot has none: then it is the last frame behind the last joint
    before a light hand. Raises `InputError`
    for a robot that is not an arm, and as `load`.
    """
    if kind(name) != "arm":
        called = load(name).name
        raise InputError(
            f"robot '{called}' has no tool: it is not an arm", "arms: " + ", ".join(names("arm"))
        )
    from trajopt.inspection.limbs import tool_joint  # slow to import

    given = _stated(name, "TOOL")
    model = (loaded or load(name)).model
    carried = [frame.name for frame in model.frames if frame.parentJoint == tool_joint(model)]
    tool = carried[-1] if given is None else given
    if not model.existFrame(tool):
        raise InputError(f"TOOL of {name} is {shown(tool)}, not a frame of the model", ", ".join(carried))
    return str(tool)


def feet(robot: Robot) -> tuple[str, ...]:
    """Return the names of the contacts that a robot stands on in its reference: those at the bottom."""
    return tuple(feet_in_base(robot)) if robot.contacts else ()


def _stated(name: str | Robot, what: str) -> object:
    """Return a name that a robot's module defines, or None."""
    if isinstance(name, Robot) or is_packaged(name.removesuffix(ROLLING)):
        return None
    return getattr(_module(name), what, None)


def _module(name: str) -> ModuleType:
    name = name.removesuffix(ROLLING)
    if name.endswith(".py"):
        path = Path(name).expanduser().absolute()
        if not path.is_file():
            raise InputError(f"robot file {path} does not exist")
        return _from_file(path, path.stat().st_mtime_ns)
    if name.endswith((".urdf", ".xml")):
        made = f"a .py file with build(): trajopt robot {name} --write FILE.py makes one"
        raise InputError(f"'{name}' is a description, not a robot", made)
    if name not in names():
        if elsewhere := packaged_as(name):
            raise InputError(f"robot '{name}' is unknown", f"did you mean {' or '.join(elsewhere)}?")
        allowed = (*names(), *(f"{package}:NAME" for package in PACKAGES), OWN_FILE)
        raise not_among(allowed, name, f"robot '{name}' is unknown")
    return importlib.import_module(f"{__name__}.{name}")


@lru_cache(maxsize=16)
def _guessed(path: Path, name: str, _changed: int) -> Robot:
    """Return the robot of a description with guessed feet and posture, once for each version of the file."""
    from trajopt.inspection.starter import guessed  # slow to import

    return replace(guessed(path), name=name)


@lru_cache(maxsize=16)
def _from_file(path: Path, _changed: int) -> ModuleType:
    """Run a file as a module, once for each version of the file."""
    specification = importlib.util.spec_from_file_location(f"robot_file_{path.stem}", path)
    if specification is None or specification.loader is None:
        raise InputError(f"robot file {path} cannot be imported", "a file that ends in .py")
    module = importlib.util.module_from_spec(specification)
    try:
        specification.loader.exec_module(module)
    except TrajoptError as error:
        raise placed(error, f"{path}, line {line_in(path, error)}") from error
    except Exception as error:
        raise InputError(f"robot file {path} cannot be run: {failure(error, path)}") from error
    if not callable(getattr(module, "build", None)):
        raise InputError(f"robot file {path} has no build()", "def build() -> Robot")
    return module


def _file(module: ModuleType) -> Path:
    return Path(module.__file__ or module.__name__)
