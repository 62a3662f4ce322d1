"""Problem families: a name, parameters with units and ranges, and a function that builds a Problem."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

from trajopt.arguments import checked
from trajopt.errors import InputError, TrajoptError, in_file, not_among, shown

if TYPE_CHECKING:
    from trajopt.problem.problem import Problem

# Name of a robot to look up, as opposed to a file: such as go2, go2:rolling, example-robot-data:romeo.
PLAIN_NAME = re.compile(r"[\w+-]+(:[\w+-]+)*")
# Names of parameters in solution files of earlier versions, and their current names.
FORMER_NAMES = {"effort": "torque_limit", "effort_share": "torque_share", "minimise": "goal"}

# Unit -> suffixes in which it, and its rate per second, may be written, and their sizes in that unit.
_SUFFIXES = {
    "rad": {"deg": math.pi / 180, "rad": 1.0},
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001},
    "s": {"s": 1.0, "ms": 0.001},
}


@checked
@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A numeric parameter of a family.

    Args:
        name: name of the parameter.
        default: None means that it is derived from others.
        unit: unit of the value and its bounds.
        lower: least value.
        upper: largest value.
        meaning: one line of help.
    """

    name: str
    default: float | None
    unit: str
    lower: float
    upper: float
    meaning: str

    def parse(self, value: object) -> float:
        """The value as a number within range; text may carry a unit, as ``45deg``. Raises `InputError`."""
        allowed = f"allowed: {self.lower:g} to {self.upper:g} {self.unit}".rstrip()
        if isinstance(value, str):
            match = re.fullmatch(r"\s*([-+0-9.eE]+|[-+]?(?:nan|inf))\s*([a-zA-Z/]*)\s*", value)
            sizes = self._sizes()
            if not match or match[2] not in sizes:
                raise InputError(f"parameter {self.name}={shown(value)} is not a number", allowed)
            try:
                number = float(match[1]) * sizes[match[2]]
            except ValueError:
                raise InputError(f"parameter {self.name}={shown(value)} is not a number", allowed) from None
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            number = float(value)
        else:
            raise InputError(f"parameter {self.name}={shown(value)} is not a number", allowed)
        if not (math.isfinite(number) and self.lower <= number <= self.upper):
            hint = (
                f" (for degrees write {self.name}={value}deg)"
                if self.unit == "rad" and abs(number) > math.pi and not str(value).strip().endswith("deg")
                else ""
            )
            raise InputError(f"parameter {self.name} is {number:g}", allowed + hint)
        return number

    def _sizes(self) -> dict[str, float]:
        """Suffix that a value may carry -> its size in the unit; the /s of a rate may be left out."""
        kind = self.unit.removesuffix("/s")
        sizes = {"": 1.0, self.unit: 1.0} | _SUFFIXES.get(kind, {})
        if kind != self.unit:
            sizes |= {f"{name}/s": size for name, size in _SUFFIXES.get(kind, {}).items()}
        return sizes


@checked
@dataclass(frozen=True, kw_only=True)
class Choice:
    """A parameter of a family that is one of the words ``choices``."""

    name: str
    default: str
    choices: tuple[str, ...]
    meaning: str

    unit: ClassVar[str] = ""
    lower: ClassVar[None] = None
    upper: ClassVar[None] = None

    def parse(self, value: object) -> str:
        """The word, if it is one of the choices. Raises InputError."""
        if value not in self.choices:
            raise InputError(f"parameter {self.name}={shown(value)}", f"allowed: {', '.join(self.choices)}")
        return str(value)


@dataclass(frozen=True, kw_only=True)
class RobotName:
    """The parameter ``robot``: a robot by name (or a file that builds one), which the family looks up.

    `Family.load` also takes a `Robot`; the problem's parameter is then a text by which no robot is found.
    """

    default: str
    choices: tuple[str, ...]

    name: ClassVar[str] = "robot"
    meaning: ClassVar[str] = "name of a robot, or a .py file with build(); tested ones are listed"
    unit: ClassVar[str] = ""
    lower: ClassVar[None] = None
    upper: ClassVar[None] = None

    def parse(self, value: object) -> str:
        """The text. Raises InputError for anything else."""
        if not isinstance(value, str) or not value.strip():
            raise InputError(f"parameter robot={shown(value)}", f"allowed: a name, such as {self.choices[0]}")
        return value.strip()


@checked
@dataclass(frozen=True, kw_only=True)
class Family:
    """A problem family.

    A family for several robots has a parameter ``robot``, which may be any other robot that suits it.

    Args:
        name: name of the family.
        phases: names of the phases, for tables.
        summary: one line of help.
        parameters: what may be chosen.
        build: takes every parameter by name and returns the problem. The problem gets the parameters' values;
            ``build`` sets only those that it derives.
        robot: name of the only or default robot.
        robots: names of the robots on which the family is tested, the default first.
        variants: settings with which it is tested too, such as ``actuation=jerk``, and on which robots.

    Raises:
        InputError: without a robot, and for settings that the family does not have.
    """

    name: str
    phases: tuple[str, ...]
    summary: str
    parameters: tuple[Parameter | Choice | RobotName, ...]
    build: Callable[..., Problem]
    robot: str = ""
    robots: tuple[str, ...] = ()
    variants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.robot or self.robots):
            raise InputError(f"family '{self.name}' has no robot", "allowed: robot or robots")
        if self.robots:
            named = RobotName(default=self.robot or self.robots[0], choices=self.robots)
            object.__setattr__(self, "parameters", (named, *self.parameters))
        object.__setattr__(self, "robots", self.robots or (self.robot,))
        object.__setattr__(self, "robot", self.robot or self.robots[0])
        for setting in self.variants:
            name, _, value = setting.partition("=")
            self.parameter(name).parse(value)

    @property
    def tested(self) -> list[tuple[str, tuple[str, ...]]]:
        """Its name, followed by a colon and a setting if there is one, and the robots it is tested on."""
        return [(self.name, self.robots), *((f"{self.name}:{key}", on) for key, on in self.variants.items())]

    @property
    def takes_robot(self) -> bool:
        """Whether the robot is a parameter."""
        return any(isinstance(parameter, RobotName) for parameter in self.parameters)

    def of_file(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Values of the family's parameters in a solution file of any version.

        Raises `InputError` if the robot is a file: what a solution names is looked up, never run.
        """
        robot = given.get("robot")
        if robot is not None and not PLAIN_NAME.fullmatch(str(robot)):
            raise InputError(
                f"the solution names the robot {robot!r:.200}, and files that solutions name are not run",
                "allowed: a robot by name; of a file that you trust, `robot=FILE.py`",
            )
        known = {parameter.name for parameter in self.parameters}
        named = {
            name if name in known else FORMER_NAMES.get(name, name): value for name, value in given.items()
        }
        return {name: value for name, value in named.items() if name in known and value is not None}

    def parameter(self, name: str) -> Parameter | Choice | RobotName:
        """The parameter of that name; raises `InputError` that suggests a known name."""
        known = {parameter.name: parameter for parameter in self.parameters}
        if name in known:
            return known[name]
        raise not_among(known, name, f"{self.name} has no parameter '{name}'")

    def load(self, values: Mapping[str, object]) -> Problem:
        """Build the problem with ``values`` over the defaults. Raises InputError."""
        given = {name: self.parameter(name) for name in values}
        chosen: dict[str, object] = {each.name: each.default for each in self.parameters}
        from trajopt.problem.problem import Problem
        from trajopt.robot.robot import Robot

        chosen |= {
            name: value if isinstance(value, Robot) and name == RobotName.name else given[name].parse(value)
            for name, value in values.items()
        }

        try:
            problem = self.build(**chosen)
        except (TrajoptError, MemoryError):
            raise
        except Exception as error:
            raise InputError(
                f"problem '{self.name}' cannot be built: {in_file(error, self.build)}"
            ) from error
        if not isinstance(problem, Problem):
            raise InputError(
                f"build() of problem '{self.name}' returns {shown(problem)}", "allowed: a Problem"
            )
        if self.takes_robot and not isinstance(chosen["robot"], str):
            chosen["robot"] = f"{problem.robot.name} (a Robot)"
        return replace(problem, parameters={**chosen, **problem.parameters})


@checked
def choose(families: Mapping[str, Family], name: str) -> Family:
    """The family of that name; raises InputError that lists the known names."""
    if name not in families:
        raise not_among(families, name, f"problem '{name}' is unknown")
    return families[name]
