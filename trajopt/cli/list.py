"""``trajopt list``: the problems of the catalogue with their robots, phases and parameters."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from trajopt.cli.input import json_option
from trajopt.cli.report import console, plain_table, say, to_json
from trajopt.errors import InputError

if TYPE_CHECKING:
    from trajopt.problem.family import Choice, Family, Parameter, RobotName

# Headings of the brief list by kind of robot; the last has all other kinds.
OTHERS = "Others"
HEADINGS = {"arm": "Arms", "quadruped": "Quadrupeds", "biped": "Bipeds", "": OTHERS}
WIDTH = 80


@click.command("list")
@click.argument("problems", nargs=-1, metavar="[PROBLEM]...")
@click.option("--robot", metavar="NAME", help="Only problems that are tested on that robot.")
@click.option("--robots", is_flag=True, help="Robots in place of problems: names that --set robot= takes.")
@click.option("--brief", is_flag=True, help="One row per problem.  [default without PROBLEM]")
@click.option("--full", is_flag=True, help="With robots, phases and parameters.  [default with PROBLEM]")
@json_option
def list_command(
    problems: tuple[str, ...], robot: str | None, robots: bool, brief: bool, full: bool, as_json: bool
) -> None:
    """List problems, the parameters of some, or robots.

    PROBLEM is a name or a pattern such as 'biped-*'.
    """
    if brief and full:
        raise InputError("--brief and --full are both given", "allowed: one of them")
    if robots:
        if problems or robot or brief or full:
            raise InputError("--robots lists all robots", "allowed: alone, or with --json")
        _list_robots(as_json)
        return
    from trajopt.problem.catalogue import listing
    from trajopt.study.suite.cases import select

    known, kinds = listing()
    wanted = {case.problem for case in select(known, problems, [] if robot is None else [robot])}
    listed = [family for name, family in known.items() if name in wanted]
    if as_json:
        say(to_json({"problems": [_family_dict(family) for family in listed]}))
    elif brief or not (full or problems):
        _print_brief(listed, kinds)
    else:
        for family in listed:
            _print_full(family)


def _list_robots(as_json: bool) -> None:
    from trajopt.robot.catalogue import robot_names

    known = robot_names()
    if as_json:
        say(to_json({"robots": known}))
        return
    for group, names in known.items():
        _print_wrapped(f"{group}: {', '.join(names)}", 2)
    say("\nUse a name as in --set robot=NAME or robot=PACKAGE:NAME; trajopt robot NAME shows the robot.")


def _print_brief(families: Sequence[Family], kinds: Mapping[str, str]) -> None:
    """Name and summary of each family, under headings with the robots of their kind."""
    groups: dict[str, list[Family]] = {heading: [] for heading in HEADINGS.values()}
    for family in families:
        groups[HEADINGS.get(kinds.get(family.robot, ""), OTHERS)].append(family)
    for heading, members in groups.items():
        if members:
            robots = ", ".join(dict.fromkeys(name for family in members for name in family.robots))
            _print_wrapped(f"{heading}: {robots}", 2)
            indent = max(len(family.name) for family in members) + 4
            for family in members:
                _print_wrapped(f"  {family.name:{indent - 2}}{family.summary}", indent)
            say()
    say("trajopt list PROBLEM shows its robots, phases and parameters.")


def _print_wrapped(text: str, indent: int) -> None:
    say("\n".join(textwrap.wrap(text, WIDTH, subsequent_indent=indent * " ")))


def _family_dict(family: Family) -> dict[str, Any]:
    """A family as JSON; a parameter that is a choice has no range."""
    fields = ("name", "unit", "lower", "upper", "default", "choices", "meaning")
    return {
        "name": family.name,
        "robot": family.robot,
        "robots": list(family.robots),
        "phases": list(family.phases),
        "summary": family.summary,
        "parameters": [
            {name: getattr(each, name) for name in fields if hasattr(each, name)}
            for each in family.parameters
        ],
    }


def _print_full(family: Family) -> None:
    robots = f"robot{'s' * (len(family.robots) > 1)} {', '.join(family.robots)}"
    heading = f"{family.name} ({robots}; phases {', '.join(family.phases)})\n  {family.summary}"
    rows = [(f"  {each.name}", _default(each), _range(each), each.meaning) for each in family.parameters]
    shown = console()
    shown.print(heading, soft_wrap=True)
    shown.print(plain_table(("  parameter", "default", "range", "meaning"), rows))


def _default(parameter: Parameter | Choice | RobotName) -> str:
    if isinstance(parameter.default, str):
        return parameter.default
    return "derived" if parameter.default is None else f"{parameter.default:g} {parameter.unit}".rstrip()


def _range(parameter: Parameter | Choice | RobotName) -> str:
    if parameter.lower is None or parameter.upper is None:
        return ", ".join(parameter.choices)
    return f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}".rstrip()
