"""``trajopt list``: the problems of the catalogue with their robots, phases and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.report import console, plain_table, to_json

if TYPE_CHECKING:
    from rich.table import Table

    from trajopt.problem.family import Choice, Family, Parameter, RobotName


@click.command("list")
@click.argument("problems", nargs=-1, metavar="[PROBLEM]...")
@click.option("--robot", metavar="NAME", help="Only problems that are tested on that robot.")
@click.option("--brief", is_flag=True, help="One row per problem: name, robots, summary.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def list_command(problems: tuple[str, ...], robot: str | None, brief: bool, as_json: bool) -> None:
    """List problems with robots, phases and parameters: all, or those that match patterns such as biped-*."""
    from trajopt.problem.catalogue import families
    from trajopt.study.suite.cases import select

    known = families()
    wanted = {case.problem for case in select(known, problems, [] if robot is None else [robot])}
    listed = [family for name, family in known.items() if name in wanted]
    if as_json:
        click.echo(to_json({"problems": [_family_dict(family) for family in listed]}))
    elif brief:
        rows = [(family.name, " ".join(family.robots), family.summary) for family in listed]
        console().print(plain_table(("problem", "robots", "summary"), rows, gap=2))
    else:
        shown = console()
        for family in listed:
            shown.print(_heading(family), soft_wrap=True)
            shown.print(_parameter_table(family))


def _family_dict(family: Family) -> Mapping[str, Any]:
    """A family as JSON; a parameter that is a choice has no range."""
    shared = ("unit", "lower", "upper")
    return {
        "name": family.name,
        "robot": family.robot,
        "robots": list(family.robots),
        "phases": list(family.phases),
        "summary": family.summary,
        "parameters": [
            {name: getattr(own, name) for name in shared} | vars(own) for own in family.parameters
        ],
    }


def _heading(family: Family) -> str:
    robots = f"robot{'s' * (len(family.robots) > 1)} {', '.join(family.robots)}"
    return f"{family.name} ({robots}; phases {', '.join(family.phases)})\n  {family.summary}"


def _parameter_table(family: Family) -> Table:
    rows = [(f"  {own.name}", _default(own), _range(own), own.meaning) for own in family.parameters]
    return plain_table(("  parameter", "default", "range", "meaning"), rows)


def _default(parameter: Parameter | Choice | RobotName) -> str:
    if isinstance(parameter.default, str):
        return parameter.default
    return "derived" if parameter.default is None else f"{parameter.default:g} {parameter.unit}".rstrip()


def _range(parameter: Parameter | Choice | RobotName) -> str:
    if parameter.lower is None or parameter.upper is None:
        return ", ".join(parameter.choices)
    return f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}".rstrip()
