"""Values in messages: short, in one line, and objects by their kind."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trajopt.errors import WIDTH, shown
from trajopt_library import robots


class Loud:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.5, "1.5"),
        ("a b", "'a b'"),
        (None, "None"),
        ([1, (2,), "x"], "[1, (2,), 'x']"),
        ({"a": Loud()}, "{'a': a Loud}"),
        (np.float64(2.0), "2.0"),
        (np.array([1.0, np.nan]), "[1.0, nan]"),
        (np.zeros((20, 3)), "an array of shape (20, 3)"),
        (np.zeros(0), "an array of shape (0,)"),
        (Loud(), "a Loud"),
        (Loud, "the class Loud"),
        (Path("a/b"), "'a/b'"),
        (len, "a builtin_function_or_method"),
        (list(range(20)), "[0, 1, 2, 3, 4, 5, 6, 7, ...]"),
    ],
)
def test_values_are_shown(value: Any, text: str) -> None:
    assert shown(value) == text


def test_a_robot_is_a_robot() -> None:
    assert shown([robots.load("ur5")]) == "[a Robot]"


def test_long_and_endless_values_are_cut() -> None:
    endless: list[Any] = []
    endless.append(endless)
    assert shown(endless) == "[[[[...]]]]"
    assert len(shown("x" * 1000)) == WIDTH
    assert "\n" not in shown("a\nb")
