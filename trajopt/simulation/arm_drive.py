"""A drive of an arm in MuJoCo: its tool follows a target that moves at a bounded speed to scripted places."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.collision import Obstacle
from trajopt.control.mpc.arm import ArmController, ArmSettings, ToolTarget
from trajopt.control.mpc.commands import unreadable
from trajopt.control.reference import ContactTimeline
from trajopt.errors import InputError, expanded, shown
from trajopt.kinds import ArrayShape
from trajopt.motion.solution import Solution
from trajopt.robot.kinematics import frame_pose
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.simulation.drive_report import PlanFigures, plan_figures
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.lockstep import LAST
from trajopt.simulation.record import SimulationRecord
from trajopt.simulation.scene import Scene
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulated import simulated_solution

# Largest offset of the target from its start, over the robot's length, and its speed in natural units.
FARTHEST, TARGET_SPEED = 0.35, 0.2
# Period and delay of plans, s.
PERIOD, DELAY = 0.02, 0.01
# Control rate, Hz.
RATE = 500.0
# Interval at which distances between links are computed, s.
STRIDE = 0.02
AXES = ("x", "y", "z")
COLUMNS = ("time", *AXES)
# The value of a log entry.
Sent = TypeVar("Sent")


@dataclass(frozen=True, kw_only=True)
class ArmDriveReport(PlanFigures):
    """Figures of an arm's drive; those of plans include the part of the motion that was not kept.

    Args:
        tool: frame that follows the target.
        error_mean, error_95, error_max: distance of the tool from the moving target, m.
        nearest: least distance between links and to obstacles, m; None without such pairs.
        beyond: largest violation of a joint's position limits, rad or m.
        rate: largest ratio of a joint's velocity to its limit.
        targets: times, s, and positions, m, to which the target was sent.
    """

    tool: str
    error_mean: float
    error_95: float
    error_max: float
    nearest: float | None
    beyond: float
    rate: float
    targets: tuple[tuple[float, tuple[float, ...]], ...]

    def table(self) -> str:
        """Figures as text, one per line."""
        mean, high, most = (1e3 * error for error in (self.error_mean, self.error_95, self.error_max))
        lines = [
            ("driven", f"{self.simulated:.3f} s"),
            ("tool from target", f"{mean:.1f} mm mean, {high:.1f} at 95 %, {most:.1f} largest"),
            ("nearest bodies", "-" if self.nearest is None else f"{1e3 * self.nearest:.0f} mm"),
            ("joints", f"{self.beyond:.2g} rad beyond limits, rates {100 * self.rate:.0f} % of theirs"),
            *self._lines,
        ]
        text = [f"{name:27} {value}" for name, value in lines]
        end = [f"it failed at {self.fall_time:.3f} s: {self.fall_reason}"] if self.fell else []
        return "\n".join([*text, *end])


@dataclass(frozen=True, kw_only=True)
class ArmDrive:
    """The recorded drive of an arm.

    Args:
        scene: the simulated scene.
        timeline: the ticks.
        record: the record.
        target: position of the target at the ticks (n, 3), m.
        report: the report.
    """

    scene: Scene
    timeline: ContactTimeline
    record: SimulationRecord
    target: np.ndarray
    report: ArmDriveReport

    @classmethod
    def of(cls, driven: DrivenScene, steering: ToolSteering) -> ArmDrive:
        """The recorded part of a simulation under ``steering``."""
        timeline, record = driven.timeline.until(driven.row), driven.recorded()
        times = driven.offset + timeline.t[: len(record.feet)]
        target = np.array([steering.path.at(time)[0] for time in times.tolist()])
        report = _report(driven, steering, record, target)
        return cls(scene=driven.scene, timeline=timeline, record=record, target=target, report=report)

    def as_solution(self) -> Solution:
        """The motion as a solution of the same model; ``statistics.simulated`` is true."""
        return simulated_solution(self.scene, self.timeline, self.record, self.report)


def _report(
    driven: DrivenScene, steering: ToolSteering, record: SimulationRecord, target: np.ndarray
) -> ArmDriveReport:
    robot, controller, coordinates = driven.robot, steering.controller, driven.scene.coordinates
    qpos, qvel = (rows[: len(target)] for rows in (record.qpos, record.qvel))
    q, v = coordinates.from_mujoco(qpos), coordinates.rates_from_mujoco(qpos, qvel)
    tool = np.array([frame_pose(robot, each, controller.tool).translation for each in q])
    error, period = np.linalg.norm(tool - target, axis=1), driven.timeline.period
    distances = controller.scene.distances(q[:: max(1, round(STRIDE / period))])
    beyond = np.maximum(robot.position_lower - q, q - robot.position_upper)
    return ArmDriveReport(
        **plan_figures(controller, record, period, driven.fall),
        tool=controller.tool,
        error_mean=float(error.mean()),
        error_95=float(np.percentile(error, 95)),
        error_max=float(error.max()),
        nearest=float(distances.min()) if distances.size else None,
        beyond=max(float(beyond.max()), 0.0),
        rate=float((np.abs(v) / robot.velocity_limit).max()),
        targets=tuple(
            (time, tuple(place.tolist())) for time, place in since(steering.path.goals, driven.offset)
        ),
    )


def since(log: Sequence[tuple[float, Sent]], offset: float) -> list[tuple[float, Sent]]:
    """The entries of a log in effect from ``offset`` s on, with times relative to it; the first is at 0."""
    times = [max(time - offset, 0.0) for time, _ in log]
    first = sum(time == 0.0 for time in times) - 1
    return [(time, sent) for time, (_, sent) in zip(times, log, strict=True)][first:]


class ToolSteering:
    """An arm's controller whose target moves at a bounded speed to a goal, and keeps its orientation.

    Args:
        controller: a new controller.
        goal: the goal (3,), m, at a time in s.

    Attributes:
        low: lower corner (3,) of the box in which goals lie, m.
        high: upper corner (3,) of this box, m.
        place: place (3,) of the target in the last tick, m.
        path: the path of the target so far.
    """

    def __init__(self, controller: ArmController, goal: Callable[[float], np.ndarray]) -> None:
        self.controller, self.goal, robot = controller, goal, controller.robot
        self._start = frame_pose(robot, robot.reference, controller.tool)
        units, far = NaturalUnits.of(robot.model), FARTHEST * robot.length
        self.place = self._start.translation.copy()
        self.low, self.high = self.place - far, self.place + far
        self.path = TargetPath(self.place, TARGET_SPEED * units.length / units.time)

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `ArmController.step`."""
        self.path.send(t, self.goal(t))
        self.place, velocity = self.path.at(t)
        target = ToolTarget(position=self.place, rotation=self._start.rotation, velocity=velocity)
        return self.controller.step(t, q, v, target)


class TargetPath:
    """A target that moves along straight lines at constant speed to where it was last sent.

    Args:
        start: initial position (3,), m.
        speed: m/s.

    ``goals`` are the times, s, and positions (3,), m, to which it was sent.
    """

    def __init__(self, start: np.ndarray, speed: float) -> None:
        self._speed = speed
        self.goals = [(0.0, start)]
        self._from = [start]

    def send(self, time: float, goal: np.ndarray) -> None:
        """Send the target to ``goal`` (3,), m, at ``time``, s, which is not before that of the last call."""
        if not np.array_equal(goal, self.goals[-1][1]):
            start, _ = self.at(time)
            self.goals.append((time, goal))
            self._from.append(start)

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,), m, and velocity (3,), m/s, of the target at ``time``, s."""
        last = max(bisect_right(self.goals, time, key=lambda sent: sent[0]) - 1, 0)
        (begun, goal), start = self.goals[last], self._from[last]
        way = goal - start
        far, gone = float(np.linalg.norm(way)), self._speed * (time - begun)
        if gone >= far:
            return goal, np.zeros(3)
        return start + gone / far * way, self._speed / far * way


def read_targets(path: Path | str) -> np.ndarray:
    """Read targets from a CSV file: rows (n, 4) of `COLUMNS`, s and m; an empty field repeats the one above.

    Raises:
        InputError: for an unreadable file, other columns, or a line with a value that is not a finite number.
    """
    allowed = f"allowed: a CSV file with the columns {', '.join(COLUMNS)}, finite numbers"
    path = expanded(path)
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
    """Simulate an arm whose tool follows a target, in lockstep with the solver.

    Args:
        robot: a robot with a fixed base.
        targets: rows (n, 4) of time, s, and position in the world, m; times increase from 0.
        duration: duration of the drive, s; default: until `LAST` s after the last time.
        settings: settings of the controller; default: a plan every `PERIOD` s.
        obstacles: obstacles that the arm avoids.
        hardware: fields of `SimulationSettings`; ``control_rate`` is `RATE` Hz by default.

    Raises:
        InputError: for another base, invalid times, positions out of range, or settings that are not allowed.
    """
    times = targets[:, 0]
    if not len(times) or times[0] != 0 or (np.diff(times) <= 0).any():
        raise InputError(f"times of targets are {times.tolist()}", "allowed: the first 0, then increasing, s")
    chosen = settings or ArmSettings(period=PERIOD, delay=DELAY)
    wanted = SimulationSettings(**{"control_rate": RATE, "rolling": True, **hardware})
    driven = DrivenScene(robot, wanted, duration or float(times[-1]) + LAST, obstacles=obstacles)
    starts, goals = np.round(times * wanted.control_rate), targets[:, 1:]

    def goal(time: float) -> np.ndarray:
        tick = round(time * wanted.control_rate)
        return np.asarray(goals[np.searchsorted(starts, tick, side="right") - 1])

    steering = ToolSteering(ArmController(robot, None, obstacles, chosen), goal)
    for row, axis in zip(*np.nonzero((goals < steering.low) | (goals > steering.high)), strict=True):
        allowed = f"allowed: {steering.low[axis]:.4g} to {steering.high[axis]:.4g} m"
        raise InputError(f"{AXES[axis]} is {shown(float(goals[row, axis]))}", allowed)
    driven.begin(steering)
    driven.advance(len(driven.timeline.t))
    return ArmDrive.of(driven, steering)
