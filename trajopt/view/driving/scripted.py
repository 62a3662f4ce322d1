"""A scripted drive of an arm in MuJoCo: targets at given times, simulated in lockstep with the solver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.collision import Obstacle
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.mpc.arm import ArmSettings
from trajopt.mpc.commands import unreadable
from trajopt.mpc.lockstep import LAST
from trajopt.robot.robot import Robot
from trajopt.view.driving.arm_drive import ArmDrive
from trajopt.view.driving.drivers import ArmDriver
from trajopt.view.driving.session import DriveSession

COLUMNS = ("time", "x", "y", "z")


def read_targets(path: Path) -> np.ndarray:
    """Read targets from a CSV file: rows (n, 4) of `COLUMNS`, s and m; an empty field repeats the one above.

    Raises:
        InputError: for an unreadable file, other columns, or a line with a value that is not a finite number.
    """
    allowed = f"allowed: a CSV file with the columns {', '.join(COLUMNS)}, finite numbers"
    try:
        head, *lines = path.read_text(encoding="utf-8-sig").splitlines() or [""]
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(path, error, allowed) from None
    if tuple(name.strip() for name in head.split(",")) != COLUMNS:
        raise InputError(f"{path}: its first line is '{head}'", allowed)
    rows = [[math.nan] * len(COLUMNS)]
    for number, line in enumerate(lines, 2):
        try:
            texts = zip(line.split(","), rows[-1], strict=True)
            rows.append([float(text) if text.strip() else before for text, before in texts])
        except ValueError:
            rows.append([math.nan])
        if not all(map(math.isfinite, rows[-1])):
            raise InputError(f"{path}, line {number}: '{line}'", allowed)
    return np.array(rows[1:]).reshape(-1, len(COLUMNS))


@checked
def drive_arm(
    robot: Robot,
    targets: Annotated[np.ndarray, ArrayShape((None, 4))],
    *,
    duration: Positive | None = None,
    settings: ArmSettings | None = None,
    obstacles: Sequence[Obstacle] = (),
    **hardware: Any,
) -> ArmDrive:
    """Simulate an arm whose tool follows a target, which moves at a bounded speed to scripted positions.

    Args:
        robot: with a fixed base.
        targets: rows (n, 4) of time, s, and position in the world, m; times increase from 0.
        duration: of the drive, s; default: until `LAST` s after the last time.
        settings: of the controller.
        obstacles: avoided by the arm.
        hardware: see `DriveSession`.

    Raises:
        InputError: for another base, invalid times, positions out of range, or settings that are not allowed.
    """
    times = targets[:, 0]
    if not len(times) or times[0] != 0 or (np.diff(times) <= 0).any():
        raise InputError(f"times of targets are {times.tolist()}", "allowed: the first 0, then increasing, s")
    driver = ArmDriver(robot, settings=settings, obstacles=obstacles)
    goals = [dict(zip(COLUMNS[1:], place, strict=True)) for place in targets[:, 1:].tolist()]
    for goal in goals:
        driver.obey(goal)
    session = DriveSession(driver, keep=duration or float(times[-1]) + LAST, **hardware)
    ticks = len(session.reference.t)
    edges = [*np.minimum(np.round(times / session.reference.period).astype(int), ticks).tolist(), ticks]
    for goal, (first, last) in zip(goals, pairwise(edges), strict=True):
        driver.obey(goal)
        session.advance(last - first)
    driven = session.as_drive()
    assert isinstance(driven, ArmDrive)
    return driven
