"""Commands of a driver (gait, speeds and height), and scripts of commands over time."""

from __future__ import annotations

import csv
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from trajopt.arguments import checked
from trajopt.errors import InputError, expanded, finite_number

# The gait of a robot that stands.
STAND = "stand"
SPEEDS = ("speed", "lateral", "turn_rate")
TIME = "time"


@checked
@dataclass(frozen=True, kw_only=True)
class Command:
    """The command to a legged robot from now on.

    Args:
        gait: name of a gait of the robot, or "stand".
        speed: forward speed along the heading of the base, m/s.
        lateral: speed to the left, m/s.
        turn_rate: turn rate, positive to the left, rad/s.
        height: height of the base above its height in the reference posture, m.
    """

    gait: str = STAND
    speed: float = 0.0
    lateral: float = 0.0
    turn_rate: float = 0.0
    height: float = 0.0


@checked
@dataclass(frozen=True)
class CommandScript:
    """Commands, each valid from its time on.

    Args:
        times: start time of each command, s; increasing from 0.
        commands: one command for each time.

    Raises:
        InputError: for times that do not increase from 0, or a different number of commands.
    """

    times: tuple[float, ...]
    commands: tuple[Command, ...]

    def __post_init__(self) -> None:
        if not self.times or len(self.commands) != len(self.times):
            counts = f"{len(self.times)} times and {len(self.commands)} commands"
            raise InputError(f"a script has {counts}", "allowed: as many, one or more")
        for number, time in enumerate(self.times):
            _require_next(self.times[max(number - 1, 0) : number], time, "a script")

    def at(self, time: float) -> Command:
        """The command at ``time`` s."""
        return self.commands[max(bisect_right(self.times, time) - 1, 0)]


def read_commands(path: Path | str, gaits: Sequence[str]) -> CommandScript:
    """Read a script from a CSV file with the column time and any of gait, speed, lateral, turn_rate, height.

    An empty field keeps the previous value. Raises `InputError` with the line for times that do not increase
    from 0, unknown columns or gaits, and values that are not finite numbers.
    """
    path = expanded(path)
    known = [field.name for field in fields(Command)]
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = list(reader.fieldnames or ())
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise unreadable(path, error, "allowed: a CSV file of commands") from None
    wrong = [name for name in columns if name not in (TIME, *known) or columns.count(name) > 1]
    if wrong or TIME not in columns or not rows:
        cause = "has no column 'time', or no line below it"
        if wrong:
            cause = f"has the column '{wrong[0]}'" + " twice" * (columns.count(wrong[0]) > 1)
        raise InputError(f"{path} {cause}", f"allowed: {TIME}, and any of {', '.join(known)}")
    times: list[float] = []
    commands: list[Command] = []
    for line, row in rows:
        where = f"{path}, line {line}"
        if None in row or None in row.values():
            raise InputError(f"{where} has another number of fields", f"allowed: {len(columns)}")
        given = {name: text.strip() for name, text in row.items() if text.strip()}
        time = finite_number(f"{where}: {TIME}", given.pop(TIME, ""))
        _require_next(times, time, where)
        gait = given.pop("gait", commands[-1].gait if commands else STAND)
        if gait not in (STAND, *gaits):
            raise InputError(f"{where}: gait is '{gait}'", f"allowed: {', '.join((STAND, *gaits))}")
        numbers = {name: finite_number(f"{where}: {name}", text) for name, text in given.items()}
        commands.append(replace(commands[-1] if commands else Command(), gait=gait, **numbers))
        times.append(time)
    return CommandScript(tuple(times), tuple(commands))


def unreadable(path: Path, error: Exception, allowed: str) -> InputError:
    """The error to raise for a script that is missing or is not text."""
    why = (error.strerror if isinstance(error, OSError) else "") or "it is no text"
    return InputError(f"{path} cannot be read: {why}", allowed)


def _require_next(before: Sequence[float], time: float, where: str) -> None:
    if time <= before[-1] if before else time != 0.0:
        raise InputError(f"{where}: time is {time:g}", "allowed: the first 0, then increasing, s")
