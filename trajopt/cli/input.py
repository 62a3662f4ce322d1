"""What the command line is given: NAME=VALUE settings, solver options, the place of the output."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import click

from trajopt.errors import InputError

_INTEGER = re.compile(r"[-+]?[0-9]+", re.ASCII)
# Solvers count with C's int.
LARGEST_INTEGER = 2**31 - 1


class WholeNumber(click.ParamType):
    """A whole number from ``least`` to ``most``."""

    name = "whole number"

    def __init__(self, least: int, most: int) -> None:
        self.least, self.most = least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number; anything else is a usage error."""
        try:
            number = int(value)
        except ValueError:
            self.fail(f"'{value}' is no whole number", param, ctx)
        if not self.least <= number <= self.most:
            self.fail(f"{number} is not within {self.least} to {self.most}", param, ctx)
        return number


# Solvers count with C's int.
COUNT = WholeNumber(0, LARGEST_INTEGER)
# A finer grid takes tens of gigabytes before anything is solved; a problem knows its coarsest.
GRID = WholeNumber(-LARGEST_INTEGER, 100_000)
THREADS = WholeNumber(1, 1024)


def values_of(settings: Sequence[str], option: str) -> dict[str, str]:
    """Values by name of repeated NAME=VALUE; raises `InputError` for another form or a name given twice."""
    values: dict[str, str] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        name = name.strip()
        if not (name and equals):
            raise InputError(f"{option} '{setting}' is not of that form", "allowed: NAME=VALUE")
        if name in values:
            raise InputError(f"{option} gives '{name}' twice: {values[name]} and {value}", "allowed: once")
        values[name] = value
    return values


def options_of(settings: Sequence[str]) -> dict[str, str | int | float]:
    """Solver options by name, as whole numbers, numbers or words; raises `InputError`."""
    values = values_of(settings, "--solver-option")
    return {name: _option(name, text.strip()) for name, text in values.items()}


def _option(name: str, text: str) -> str | int | float:
    if _INTEGER.fullmatch(text) and abs(int(text)) <= LARGEST_INTEGER:
        return int(text)
    try:
        number = float(text)
    except ValueError:
        return text
    if number != number:
        raise InputError(f"--solver-option {name} is {text}", "allowed: a number or a word")
    return number
