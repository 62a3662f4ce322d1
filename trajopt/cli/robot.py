"""``trajopt robot``: joints, limits, torques needed to stand, and likely mistakes of a description."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from trajopt.cli.input import json_option, value_option
from trajopt.cli.report import say, to_json
from trajopt.errors import InputError
from trajopt.motion.output import check_apart, check_output, replacing, require_ending

if TYPE_CHECKING:
    from trajopt.dynamics.base_joint import Base
    from trajopt.robot.robot import Robot

# Endings of descriptions, from which a robot is guessed; a Xacro file is refused with its remedy.
DESCRIPTIONS = (".urdf", ".xacro", ".xml", ".mjcf")
# Families to begin with, by kind of robot, and parameters; the first that accepts the robot is offered.
SIMPLEST: dict[str, tuple[tuple[str, dict[str, str]], ...]] = {
    "arm": (("arm-reach", {}), ("arm-reach", {"orientation": "free"})),
    "quadruped": (("quadruped-stand-up", {}), ("quadruped-trot", {})),
    "biped": (("biped-squat", {}), ("biped-gait", {})),
    "hopper": (("hopper-hop", {}), ("hopper-gait", {})),
}


@click.command("robot")
@click.argument("robot")
@value_option(
    "--base", "KIND", "Base of a URDF or MJCF file: freeflyer, planar, virtual or fixed.  [default: guessed]"
)
@value_option("--write", "FILE.py", "Write a first robot file for a URDF or MJCF file, to be edited.", Path)
@value_option("--html", "OUT", "Write a page that shows the reference posture at rest.", Path)
@json_option
def robot_command(robot: str, base: str | None, write: Path | None, html: Path | None, as_json: bool) -> None:
    """Print joints, limits and contacts of ROBOT, and warnings.

    Also the torques needed to stand.

    ROBOT is a name (as in --set robot=go2), a .py file with build() -> Robot, or a description: a .urdf file,
    an .xml file (MJCF) or one of another package (as example-robot-data:romeo), for which base, feet and
    posture are guessed from the geometry: --write saves them as a .py file. Warnings do not change the exit
    status.
    """
    from trajopt.inspection.report import robot_report

    check_apart([write, html], [Path(robot)])
    if html is not None:
        require_ending(check_output(html), ".html")
    loaded = _loaded(robot, base, write)
    text = None if write is None else _starter(loaded, write)
    report = robot_report(loaded)
    report = replace(report, notes=report.notes + _guesses(robot, loaded))
    say(to_json(report.to_dict()) if as_json else report.table())
    if write is not None and text is not None:
        with replacing(write) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
        say(f"  file       {write}: feet and posture are guesses, edit them", err=as_json)
        for line in _next(write):
            say(f"  {line}", err=as_json)
    if html is not None:
        from trajopt.problem.problem import rest
        from trajopt.solving.solving import solve
        from trajopt.view.replay.show import replay

        shown = replay(solve(rest(loaded)), html=html)
        say(f"  page       {html}: {shown.size / 1e6:.1f} MB", err=as_json)


def _loaded(name: str, base: str | None, write: Path | None) -> Robot:
    from trajopt.robot.catalogue import is_packaged, robot

    path = Path(name)
    if is_packaged(name):
        loaded = robot(name)
        if base is None or loaded.visual is None:
            return loaded
        path = loaded.visual.urdf
    if path.suffix in DESCRIPTIONS:
        from trajopt.inspection.starter import guessed

        return guessed(path, cast("Base | None", base))
    for option, value in (("--base", base), ("--write", write)):
        if value is not None:
            what = f"{option} needs a .urdf or .xml file, and {name} is not one"
            raise InputError(what, "allowed: a path that ends in .urdf or .xml")
    return robot(name)


def _guesses(name: str, loaded: Robot) -> tuple[str, ...]:
    """Notes on joints that the guess of a description locks."""
    from trajopt.robot.catalogue import is_packaged

    if loaded.visual is None or not (is_packaged(name) or Path(name).suffix in DESCRIPTIONS):
        return ()
    from trajopt.inspection.starter import guess_lines

    return guess_lines(loaded.visual.urdf)


def _next(target: Path) -> list[str]:
    """Lines that name the families for a written robot, and a command that solves the simplest of them."""
    from trajopt.problem.catalogue import family, listing
    from trajopt.robot.catalogue import robot, robot_kind

    try:
        loaded = robot(str(target))
        joints = [loaded.model.frames[loaded.model.getFrameId(c.frame)].parentJoint for c in loaded.contacts]
        if (
            loaded.contacts
            and all(c.rolling for c in loaded.contacts)
            and all(loaded.model.parents[joint] == 1 for joint in joints)
        ):
            return [f"next       trajopt drive {target}"]
        kind = str(robot_kind(str(target)))
        known, kinds = listing()
        refused = f"none is for a {kind}"
        for name, values in SIMPLEST.get(kind, ()):
            try:
                family(name).load({"robot": str(target), **values})
            except InputError as error:
                refused = str(error)
                continue
            like = f"{name.split('-')[0]}-"
            fits = [one for one in known if one.startswith(like) and kinds.get(known[one].robot) == kind]
            words = " ".join(f"--set {key}={value}" for key, value in {"robot": target, **values}.items())
            return [
                f"families   {len(fits)} for a robot of kind {kind}: trajopt list '{like}*'",
                f"next       trajopt solve {name} {words}",
            ]
    except InputError as error:
        refused = str(error)
    return [f"next       no family fits: {refused}"]


def _starter(loaded: Robot, target: Path) -> str:
    from trajopt.inspection.starter import starter

    if target.suffix != ".py" or not target.absolute().parent.is_dir():
        raise InputError(f"cannot write {target}", "allowed: a .py file in an existing folder")
    if target.exists():
        raise InputError(f"{target} exists and is not overwritten", "allowed: another name")
    return starter(loaded, target)
