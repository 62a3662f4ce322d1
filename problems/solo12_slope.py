"""Solo12 hops uphill on a slope: every contact normal is tilted against gravity."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import STANDARD_GRAVITY
from trajopt.problem.family import Family
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.terms import (
    EffortLimits,
    FrameHeight,
    FrictionCone,
    PositionLimits,
    SwingClearance,
    Term,
    TerminalRest,
    TerminalState,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt_library import robots
from trajopt_library.robots.solo12 import BASE

from . import common

# A flight shorter than this leaves no time to move the feet, s.
SHORTEST_FLIGHT = 0.2


def _standing(robot: Robot, ground: FlatGround, uphill: float) -> np.ndarray:
    """Reference posture laid onto the slope, trunk parallel to it, ``uphill`` m along it."""
    turn = ground.surface.frame
    q = robot.reference.copy()
    q[0] += uphill
    q[:3] = turn @ q[:3] + ground.surface.point
    q[3:7] = pin.Quaternion(turn @ pin.Quaternion(q[3:7]).toRotationMatrix()).coeffs()
    return q


class _Guess:
    """Standing still; in flight on a parabola from one stance to the other, legs folded as they stand."""

    def __init__(self, start: np.ndarray, end: np.ndarray, stance: float, flight: float) -> None:
        self.start, self.end, self.stance, self.flight = start, end, stance, flight

    def __call__(self, t: float) -> np.ndarray:
        s = min(max((t - self.stance) / self.flight, 0.0), 1.0)
        q = self.start.copy()
        q[:3] += s * (self.end - self.start)[:3]
        q[2] += STANDARD_GRAVITY * self.flight**2 * s * (1 - s) / 2
        return q


def _terms(end: np.ndarray, top: float, ground: FlatGround, effort: float | None) -> tuple[Term, ...]:
    return (
        *common.legged_costs(acceleration=2e-2),
        EffortLimits(limit=None if effort is None else np.full(len(end) - 7, effort)),
        PositionLimits(),
        VelocityLimits(),
        FrictionCone(),
        SwingClearance(height=common.CLEARANCE, terrain=ground),
        FrameHeight(frame=BASE, height=top, phase="flight"),
        TerminalState(q=end),
        TerminalRest(q=end),
    )


def build(
    *,
    slope: float,
    distance: float,
    height: float,
    stance: float,
    flight: float | None,
    landing: float,
    friction: float,
    effort: float | None,
) -> Problem:
    """Build the hop; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("solo12")
    ground = FlatGround(friction=friction, normal=(-math.sin(slope), 0.0, math.cos(slope)))
    start, end = (_standing(robot, ground, uphill) for uphill in (0.0, distance))
    flight = max(SHORTEST_FLIGHT, 2 * math.sqrt(2 * height / STANDARD_GRAVITY)) if flight is None else flight
    return Problem(
        name="solo12-slope",
        robot=robot,
        schedule=common.hop_schedule(contact_positions(robot, end), (stance, flight, landing)),
        terrain=ground,
        initial_q=start,
        initial_v=np.zeros(robot.nv),
        terms=_terms(end, start[2] + height, ground, effort),
        guess=_Guess(start, end, stance, flight),
        default_intervals=40,
    )


FAMILY = Family(
    name="solo12-slope",
    robot="solo12",
    phases=("stance", "flight", "landing"),
    summary="hop along a slope from stance to stance and come to rest, with Coulomb's cone on its normal",
    parameters=(
        common.angle("slope", math.radians(20), "rises forward", (-0.7, 0.7)),
        common.length("distance", 0.1, "along the slope, forward", (-0.5, 0.5)),
        common.length("height", 0.05, "least rise of the base over its start in mid flight", (0.0, 0.4)),
        common.duration("stance", 0.3, "duration of the push", (1e-3, 10.0)),
        common.duration(
            "flight", None, "duration of the flight (default: from the height, at least 0.2)", (1e-3, 2.0)
        ),
        common.duration("landing", 0.4, "duration from touchdown to rest", (1e-3, 10.0)),
        common.friction(0.8),
        common.effort(),
    ),
    build=build,
)
