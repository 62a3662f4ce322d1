"""Descriptions of others: MJCF files beside what MuJoCo compiles, URDF files as first robots that solve."""

import contextlib
import multiprocessing
import re
import resource
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path

import click
import mujoco

from scripts.measure.shared import head, row
from tests.support.command_lines import invoke
from tests.support.mujoco_comparison import differences
from trajopt import InputError, Robot
from trajopt.robot import robot_file

# A description and its solve may take this much time of a processor, s.
LONGEST = 300
CERTIFIED = "yes"


@click.command()
@click.argument("files", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--only", default="", help="Of the URDF files of example-robot-data, those with this in their path."
)
def descriptions(files: tuple[Path, ...], only: str) -> None:
    """Differences of MJCF FILES from MuJoCo; without, URDF files of example-robot-data as first robots.

    Differences are the largest, relative, of masses, poses, gravity and inverse dynamics. Of every URDF file
    `trajopt robot --write` makes a robot file, and the command that it names is run, both unedited.
    """
    if not files:
        _first_files(only)
        return
    head("file", "base", "nv", "inputs", "mass, kg", "apart")
    for path in files:
        try:
            compiled = mujoco.MjModel.from_xml_path(str(path))
            robot = Robot.from_mjcf(path)
        except (ValueError, InputError) as error:
            row(path, "refused", "", "", "", " ".join(str(error).split()))
            continue
        apart = max(differences(compiled, robot.model).values())
        row(path, robot.base, robot.nv, robot.nu, f"{robot.mass:.4g}", f"{apart:.0e}")


def _first_files(only: str) -> None:
    folder = robot_file("")
    head("description", "base", "stands on", "command", "solved and certified", "why not")
    for path in sorted(folder.rglob("*.urdf")):
        if only in str(path.relative_to(folder)):
            row(str(path.relative_to(folder)), *solved(path))


def solved(path: Path) -> tuple[str, ...]:
    """Base, contacts, command, whether its motion holds, and why not, in a process of its own."""
    here, there = multiprocessing.get_context("fork").Pipe()
    process = multiprocessing.get_context("fork").Process(target=_told, args=(path, there))
    process.start()
    there.close()
    with contextlib.suppress(EOFError):  # the system ended it
        return tuple(here.recv())
    return "", "", "", "no", f"it takes more than {LONGEST:g} s of a processor"


def _told(path: Path, pipe: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        pipe.send(first_file(path))


def first_file(path: Path) -> tuple[str, ...]:
    """Write a robot file in this folder and run the command that it is offered; see `solved`."""
    result = invoke("robot", str(path), "--write", "first.py")
    written = result.output or repr(result.exception)
    title, contacts = (
        re.search(r": (\w+) base", written),
        re.findall(r"^  .* (point|surface) +\S+.* N$", written, re.M),
    )
    offered = re.search(r"^  next +trajopt (.*)", written, re.M)
    base, feet = (
        title[1] if title else "",
        ", ".join(f"{contacts.count(kind)} {name}" for kind, name in KINDS.items() if kind in contacts),
    )
    if offered is None:
        reason = re.search(r"^  next +(.*)", written, re.M)
        last = reason[1] if reason else written.strip().splitlines()[-1]
        return base, feet, "", "no", _brief(last)
    done = invoke(*offered[1].split())
    command = offered[1].replace(" --set robot=first.py", "").removeprefix("solve ")
    if done.exit_code == 0:
        return base, feet, command, CERTIFIED, ""
    found = re.search(r"^  where +(.*)", done.output, re.M)
    return base, feet, command, "no", _brief(found[1] if found else done.output)


# Contacts by the kind in a report.
KINDS = {"point": "points", "surface": "soles"}


def _brief(text: str) -> str:
    """The text in one line, as a cell of a table, without the folders of files."""
    return re.sub(r"/\S*/", "", " ".join(text.split())).replace("|", "/").removeprefix("trajopt: ")
