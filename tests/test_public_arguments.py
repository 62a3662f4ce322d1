"""Wrong arguments of public constructors are refused in one line that names the field."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

import pytest

import trajopt
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


def test_a_problems_name_is_no_problem() -> None:
    with pytest.raises(
        InputError, match=r"^problem of solve is 'solo12-jump'; allowed: .*trajopt\.load\('solo12-jump'\)"
    ):
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
    with pytest.raises(InputError, match=r"^height of Own is 'high'; allowed: a finite number$"):
        check_fields(names["Own"](weight=1.0, height="high"))
