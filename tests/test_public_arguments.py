"""Wrong arguments of public constructors are refused in one line that names the field."""

import dataclasses
import importlib
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import trajopt
from tests.support.refusals import refused
from trajopt import InputError
from trajopt.arguments import annotations_of, check_fields

ROOMS = (
    "trajopt",
    "trajopt.terms",
    "trajopt.schedule",
    "trajopt.terrain",
    "trajopt.robot",
    "trajopt.problem",
)
MORE_ROOMS = ("certify", "motion", "reduced", "reduced.scenes", "study", "view")


class Wrong:
    """A value that no field takes."""


# Public dataclasses that the library makes and users read, and bases of terms without arguments of their own.
MADE = {
    *("CurvedSurface", "NodePlace", "Posture", "Solution", "StanceMode"),
    *("BaseDynamics", "ContactAcceleration", "ContactVelocity", "ImpactDynamics"),
}


def public_dataclasses() -> set[type]:
    found = (getattr(room, name) for room in map(importlib.import_module, ROOMS) for name in dir(room))
    classes = {each for each in found if inspect.isclass(each) and dataclasses.is_dataclass(each)}
    return {each for each in classes if not inspect.isabstract(each)}


def constructors() -> Iterator[type]:
    """Every public dataclass whose arguments are checked."""
    return (kind for kind in public_dataclasses() if "checked" in kind.__init__.__code__.co_qualname)


CASES = [
    (kind, field.name)
    for kind in sorted(constructors(), key=lambda kind: kind.__name__)
    for field in dataclasses.fields(kind)
    if annotations_of(kind).get(field.name, Any) is not Any and field.init
]


def test_all_but_what_the_library_makes_is_checked() -> None:
    checked = set(constructors())
    assert {kind.__name__ for kind in public_dataclasses() - checked} == MADE


def test_the_classes_that_a_problem_is_made_of_are_checked() -> None:
    names = {kind.__name__ for kind, _ in CASES}
    terms = {"FrameHeight", "FramePose", "FrictionCone", "NormalForce", "TorqueCost", "TorqueLimits"}
    assert names >= terms | {"Contact", "FlatGround", "Moment", "Phase", "Problem", "Schedule"}


@pytest.mark.parametrize(("kind", "field"), CASES, ids=lambda part: getattr(part, "__name__", part))
def test_a_wrong_value_is_refused_with_the_name_of_the_field(kind: type, field: str) -> None:
    with pytest.raises(InputError) as refused:
        kind(**{field: Wrong()})
    message = str(refused.value)
    assert field in message
    assert kind.__name__ in message
    assert "allowed" in message
    assert "\n" not in message


# Functions of one number or array that are called at every sample.
NUMERIC = {"smooth_step"}
# Readers of what a file says, with errors of their own.
DESCRIPTIONS = {"from_description", "from_meta", "load"}


def public_functions() -> Iterator[Callable[..., Any]]:
    """Every public function, and the functions of public classes that make one."""
    rooms = [importlib.import_module(room) for room in (*ROOMS, *(f"trajopt.{room}" for room in MORE_ROOMS))]
    listed = [getattr(room, name) for room in rooms for name in dir(room) if not name.startswith("_")]
    yield from {each for each in listed if inspect.isfunction(each) and each.__name__ not in NUMERIC}
    for kind in {each for each in listed if inspect.isclass(each)}:
        for name, made in vars(kind).items():
            makes = isinstance(made, classmethod) and annotations_of(made.__func__).get("return") is kind
            if makes and name not in DESCRIPTIONS and not name.startswith("_"):
                yield getattr(kind, name)


CALLS = [
    (function, name)
    for function in sorted(public_functions(), key=lambda function: function.__qualname__)
    for name, parameter in inspect.signature(function).parameters.items()
    if annotations_of(function).get(name, Any) not in (Any, object)
    and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
]


@pytest.mark.parametrize(("function", "name"), CALLS, ids=lambda part: getattr(part, "__qualname__", part))
def test_a_wrong_argument_is_refused_by_name(function: Callable[..., Any], name: str) -> None:
    with pytest.raises(InputError) as refused:
        function(**{name: Wrong()})
    message = str(refused.value)
    assert message.startswith(f"{name} of {function.__name__}") or f".{function.__name__} is" in message
    assert "allowed" in message
    assert "\n" not in message


def test_a_problems_name_is_no_problem() -> None:
    with refused(r"^problem of solve is 'solo12-jump'; allowed: .*trajopt\.load\('solo12-jump'\)"):
        trajopt.solve("solo12-jump")  # type: ignore[arg-type]


FILE = """
from dataclasses import dataclass
from trajopt.terms import Cost

@dataclass(frozen=True, kw_only=True)
class Own(Cost):
    height: float = 0.3
    def residual(self, context, units):
        return context.frame("base").position[2] - self.height
"""


def test_a_term_from_a_file_that_is_no_known_module_is_checked() -> None:
    names: dict[str, Any] = {"__name__": "no_module_of_that_name"}
    exec(compile(FILE, "own.py", "exec", dont_inherit=True), names)
    check_fields(names["Own"](weight=1.0))
    with refused(r"^height of Own is 'high'; allowed: a finite number$"):
        check_fields(names["Own"](weight=1.0, height="high"))
