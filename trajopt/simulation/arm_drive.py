"""A drive of an arm in MuJoCo: its tool follows a target that moves at a bounded speed to scripted places."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from trajopt.arguments import Positive, checked
from trajopt.certify.figures import figure
from trajopt.collision import Obstacle
from trajopt.control.mpc.arm import ArmController, ArmSettings, ToolTarget
from trajopt.control.mpc.commands import unreadable
from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.errors import InputError, expanded, shown
from trajopt.kinds import ArrayShape
from trajopt.robot.kinematics import frame_pose
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.robot import Robot
from trajopt.robot.validation import STRAIGHT
from trajopt.simulation.clock import lockstep
from trajopt.simulation.drive_report import PlanFigures, plan_figures, since
from trajopt.simulation.driven_scene import DrivenScene
from trajopt.simulation.lockstep import LAST
from trajopt.simulation.settings import SimulationSettings
from trajopt.simulation.simulated import SimulatedMotion

# Largest offset of the target from its start, over the robot's length, and its speed in natural units.
FARTHEST, TARGET_SPEED = 0.35, 0.2
# Range of a slide without limits, over the robot's length.
MOST_SLIDE = 10.0
# Period and delay of plans, s.
PERIOD, DELAY = 0.02, 0.01
# Control rate, Hz.
RATE = 500.0
# Interval at which distances between links are computed, s.
STRIDE = 0.02
AXES = ("x", "y", "z")
COLUMNS = ("time", *AXES)


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

    WORDS: ClassVar[tuple[str, str, str]] = ("it did not fail", "it failed", "")

    tool: str
    error_mean: float = figure("tool from target, mean", "mm", scale=1e3)
    error_95: float = figure("tool from target, 95 %", "mm", scale=1e3)
    error_max: float = figure("tool from target, largest", "mm", scale=1e3)
    nearest: float | None = figure("nearest bodies", "mm", scale=1e3)
    beyond: float = figure("joints beyond their limits", "rad")
    rate: float = figure("joint rates over their limits", "%", scale=100.0)
    targets: tuple[tuple[float, tuple[float, ...]], ...]


@dataclass(frozen=True, kw_only=True)
class ArmDrive(SimulatedMotion):
    """A drive of an arm; ``target`` is the position of its target at the ticks (n, 3), m."""

    target: np.ndarray
    report: ArmDriveReport

    @classmethod
    def of(cls, driven: DrivenScene, steering: ToolSteering) -> ArmDrive:
        """The recorded part of a simulation under ``steering``."""
        timeline, record = driven.timeline.until(driven.row), driven.recorded()
        robot, controller, period = driven.robot, steering.controller, timeline.period
        times = driven.offset + timeline.t[: len(record.feet)]
        target = np.array([steering.path.at(time)[0] for time in times.tolist()])
        qpos, qvel = (rows[: len(target)] for rows in (record.qpos, record.qvel))
        q = driven.scene.coordinates.from_mujoco(qpos)
        v = driven.scene.coordinates.rates_from_mujoco(qpos, qvel)
        tool = np.array([frame_pose(robot, each, controller.tool).translation for each in q])
        error = np.linalg.norm(tool - target, axis=1)
        distances = controller.scene.distances(q[:: max(1, round(STRIDE / period))])
        beyond = np.maximum(robot.position_lower - q, q - robot.position_upper)
        goals = since(steering.path.goals, driven.offset)
        report = ArmDriveReport(
            **plan_figures(controller, record, period, driven.fall),
            tool=controller.tool,
            error_mean=float(error.mean()),
            error_95=float(np.percentile(error, 95)),
            error_max=float(error.max()),
            nearest=float(distances.min()) if distances.size else None,
            beyond=max(float(beyond.max()), 0.0),
            rate=float((np.abs(v) / robot.velocity_limit).max()),
            targets=tuple((time, tuple(place.tolist())) for time, place in goals),
        )
        return cls(**driven.motion_fields(timeline, record), target=target, report=report)


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
        slides = slide_ranges(robot, controller.tool)
        self.low, self.high = self.place - far + slides[0], self.place + far + slides[1]
        self.path = TargetPath(self.place, TARGET_SPEED * units.length / units.time)

    def torque(self, t: float, q: np.ndarray, v: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Torques (nu,) at ``t`` s, see `ArmController.step`."""
        self.path.send(t, self.goal(t))
        self.place, velocity = self.path.at(t)
        target = ToolTarget(position=self.place, rotation=self._start.rotation, velocity=velocity)
        return self.controller.step(t, q, v, target)


def slide_ranges(robot: Robot, frame: str) -> np.ndarray:
    """Least and largest displacement (2, 3), m, world, of a frame by slides from the reference posture.

    A slide without limits counts as `MOST_SLIDE` lengths of the robot.
    """
    model, most, ranges = robot.model, MOST_SLIDE * robot.length, np.zeros((2, 3))
    moved = contact_jacobian(model, robot.reference, [(frame, 3)])
    for joint in list(model.joints)[1:]:
        if joint.nq == 1 and joint.shortname().startswith(STRAIGHT):
            row, at = joint.idx_v, joint.idx_q
            limits = np.array([robot.position_lower[at], robot.position_upper[at]]) - robot.reference[at]
            ends = np.clip(limits, -most, most)[:, None] * moved[:, row]
            ranges += [ends.min(axis=0), ends.max(axis=0)]
    return ranges


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
    driven.simulate(lockstep)
    return ArmDrive.of(driven, steering)
