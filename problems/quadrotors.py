"""Flights of quadrotors: through a window and back, and a flip, from hovering to hovering."""

import math
from functools import partial

import numpy as np
import pinocchio as pin

from trajopt.collision import BoxObstacle, Obstacle
from trajopt.dynamics import gravity_of
from trajopt.errors import InputError
from trajopt.problem import Family, Problem
from trajopt.robot import Robot
from trajopt.schedule import Moment, Phase, Schedule, middle_of, start_of
from trajopt.terms import Clearance, FrameDirection, FramePose, effort_costs
from trajopt.terrain import smooth_step
from trajopt_library import robots

from . import common

# Rates and accelerations cost little compared with thrusts: there is no posture to keep.
EFFORT = effort_costs(acceleration=1e-3, velocity=1e-3, posture=0.0)
# Frame of the window: sides of its bars, m, and the distance that the robot keeps from them.
BAR, MARGIN = 0.1, 0.02
# Default duration over sqrt(d / g) for a distance d: mean accelerations are then g / 4.
UNHURRIED = 4.0
# Default duration of a flip, s, and fraction of it for which the rise in the guess is a free fall.
FLIP, FALL = 0.9, 0.5
# Largest residual force and moment in hovering, over the weight (times 1 m).
HOVERING = 1e-6
# Largest angle to upside down at the middle of a flip, and to lying on a side shortly before and after.
WITHIN = math.pi / 3


def _quadrotor(name: str) -> Robot:
    from scipy.optimize import lsq_linear  # slow; not needed to list problems

    robot = robots.load(name)
    if robot.base != "freeflyer" or not robot.thrusters:
        raise InputError(f"robot '{robot.name}' cannot fly", "allowed: a free base with thrusters")
    weight = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.reference)
    most = np.inf if robot.torque_limit is None else robot.torque_limit
    inputs = lsq_linear(robot.actuation.matrix, weight, (robot.least_torque(np.full(robot.nu, np.inf)), most))
    if np.abs(inputs.fun).max() > HOVERING * robot.weight:
        raise InputError(f"robot '{robot.name}' cannot hover level", "thrusters that balance its weight")
    return robot


def _at(robot: Robot, position: np.ndarray, turn: np.ndarray | None = None) -> np.ndarray:
    """Return the reference (nq,) with its base at a position (3,), m, rotated by a rotation vector."""
    q = robot.reference.copy()
    q[:3] = position
    rotation = pin.exp3(np.zeros(3) if turn is None else turn) @ pin.Quaternion(q[3:7]).toRotationMatrix()
    q[3:7] = pin.Quaternion(rotation).coeffs()
    return q


def window_frame(centre: np.ndarray, width: float, height: float) -> tuple[Obstacle, ...]:
    """Four bars around an opening across x at ``centre`` (3,), m."""
    across, up = (width + BAR) / 2, (height + BAR) / 2
    beside, above = np.array([BAR, BAR, height + 2 * BAR]), np.array([BAR, width, BAR])
    bars = {
        "left": (beside, [0.0, across, 0.0]),
        "right": (beside, [0.0, -across, 0.0]),
        "top": (above, [0.0, 0.0, up]),
        "bottom": (above, [0.0, 0.0, -up]),
    }
    return tuple(
        BoxObstacle(name=name, sides=sides, position=centre + offset, rotation=np.eye(3))
        for name, (sides, offset) in bars.items()
    )


def build_window(
    *,
    robot: str,
    distance: float,
    side: float,
    rise: float,
    width: float,
    opening: float,
    height: float,
    duration: float | None,
) -> Problem:
    """Build the flight to the window and back; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = _quadrotor(robot)
    start = np.array([0.0, 0.0, height])
    centre = start + np.array([distance, side, rise])
    nominal = UNHURRIED * math.sqrt(float(np.linalg.norm(centre - start)) / gravity_of(body.model))
    once = (2 * nominal if duration is None else duration) / 2
    schedule = Schedule((Phase(name="out", duration=once), Phase(name="back", duration=once)))

    return common.problem(
        "quadrotor-window",
        body,
        schedule,
        partial(_there_and_back, body, start, centre - start, once),
        costs=EFFORT,
        more=(
            FramePose(frame=body.model.frames[2].name, position=centre, at=start_of("back")),
            Clearance(obstacles=window_frame(centre, width, opening), margin=MARGIN),
        ),
        initial_q=_at(body, start),
        end=_at(body, start),
        parameters={"duration": 2 * once},
        default_intervals=40,
    )


def _there_and_back(body: Robot, start: np.ndarray, way: np.ndarray, once: float, t: float) -> np.ndarray:
    part = t / once if t < once else 2 - t / once
    return _at(body, start + smooth_step(part) * way)


def _turning(
    body: Robot, start: np.ndarray, moved: tuple[np.ndarray, np.ndarray], duration: float, t: float
) -> np.ndarray:
    """Make a full turn about an axis while rising and falling; ``moved``: rise (3,) m and axis (3,)."""
    s, (rise, about) = t / duration, moved
    return _at(body, start + 16 * (s * (1 - s)) ** 2 * rise, 2 * math.pi * smooth_step(s) * about)


def build_flip(*, robot: str, axis: str, height: float, duration: float) -> Problem:
    """Build the flip; see ``FAMILIES`` for the parameters. Raises InputError."""
    body = _quadrotor(robot)
    about = np.array({"roll": [1.0, 0.0, 0.0], "pitch": [0.0, 1.0, 0.0]}[axis])
    start, up = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0])
    rise = gravity_of(body.model) * (FALL * duration) ** 2 / 8
    schedule = Schedule((Phase(name="flip", duration=duration),))
    side = np.cross(up, about)

    def upward(direction: np.ndarray, at: Moment) -> FrameDirection:
        base = body.model.frames[2].name
        return FrameDirection(frame=base, axis=tuple(direction), direction=tuple(up), angle=WITHIN, at=at)

    return common.problem(
        "quadrotor-flip",
        body,
        schedule,
        partial(_turning, body, start, (rise * up, about), duration),
        costs=EFFORT,
        more=(
            upward(side, Moment("flip", 0.4)),
            upward(-up, middle_of("flip")),
            upward(-side, Moment("flip", 0.6)),
        ),
        initial_q=_at(body, start),
        end=_at(body, start),
        parameters={"duration": duration},
        default_intervals=40,
    )


FAMILIES = (
    Family(
        name="quadrotor-window",
        robots=("iris",),
        phases=("out", "back"),
        summary="fly from hovering into a window and back, clear of its frame",
        parameters=(
            common.number("distance", 3.0, "m", "way ahead to the window", (0.5, 100.0)),
            common.number("side", 1.0, "m", "way to the left", (-100.0, 100.0)),
            common.number("rise", 0.5, "m", "way up", (-100.0, 100.0)),
            common.number("width", 0.9, "m", "of the opening", (0.1, 10.0)),
            common.number("opening", 0.5, "m", "height of the opening", (0.1, 10.0)),
            common.number("height", 1.5, "m", "of the start over the ground", (0.2, 100.0)),
            common.duration("duration", None, "duration (default: from the distance)", (1e-1, 60.0)),
        ),
        build=build_window,
    ),
    Family(
        name="quadrotor-flip",
        robots=("iris",),
        phases=("flip",),
        summary="a full turn in the air, from hovering to hovering at the same place",
        parameters=(
            common.choice("axis", "axis of the turn", "roll", "pitch"),
            common.number("height", 1.5, "m", "of the start over the ground", (0.5, 100.0)),
            common.duration("duration", FLIP, "duration", (1e-1, 10.0)),
        ),
        build=build_flip,
    ),
)
