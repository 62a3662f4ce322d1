"""Solo12 hops uphill on a slope: every contact normal is tilted against gravity."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

import robots
from trajopt.family import Family, Parameter
from trajopt.model_quantities import STANDARD_GRAVITY
from trajopt.node_terms import FrameHeight, SwingClearance, TerminalRest, TerminalState
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.terms import (
    AccelerationCost,
    EffortLimits,
    FrictionCone,
    PositionLimits,
    PostureCost,
    Term,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)

BASE = "base_link"
# Least distance of a foot from the slope in mid flight, m.
CLEARANCE = 0.03
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


def _footholds(robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {c.name: data.oMf[robot.model.getFrameId(c.frame)].translation.copy() for c in robot.contacts}


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
        TorqueCost(weight=1.0),
        AccelerationCost(weight=2e-2),
        VelocityCost(weight=1e-2),
        PostureCost(weight=1e-1),
        WrenchCost(weight=1e-2),
        EffortLimits(limit=None if effort is None else np.full(len(end) - 7, effort)),
        PositionLimits(),
        VelocityLimits(),
        FrictionCone(),
        SwingClearance(height=CLEARANCE, terrain=ground),
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
    feet = tuple(contact.name for contact in robot.contacts)
    ground = FlatGround(friction=friction, normal=(-math.sin(slope), 0.0, math.cos(slope)))
    start, end = (_standing(robot, ground, uphill) for uphill in (0.0, distance))
    flight = max(SHORTEST_FLIGHT, 2 * math.sqrt(2 * height / STANDARD_GRAVITY)) if flight is None else flight
    return Problem(
        name="solo12-slope",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="stance", duration=stance, contacts=feet),
                Phase(name="flight", duration=flight),
                Phase(name="landing", duration=landing, contacts=feet, footholds=_footholds(robot, end)),
            )
        ),
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
        Parameter(
            name="slope", default=math.radians(20), unit="rad", lower=-0.7, upper=0.7, meaning="rises forward"
        ),
        Parameter(
            name="distance", default=0.1, unit="m", lower=-0.5, upper=0.5, meaning="along the slope, forward"
        ),
        Parameter(
            name="height",
            default=0.05,
            unit="m",
            lower=0.0,
            upper=0.4,
            meaning="least rise of the base over its start in mid flight",
        ),
        Parameter(
            name="stance", default=0.3, unit="s", lower=1e-3, upper=10.0, meaning="duration of the push"
        ),
        Parameter(
            name="flight",
            default=None,
            unit="s",
            lower=1e-3,
            upper=2.0,
            meaning="duration of the flight (default: from the height, at least 0.2)",
        ),
        Parameter(
            name="landing",
            default=0.4,
            unit="s",
            lower=1e-3,
            upper=10.0,
            meaning="duration from touchdown to rest",
        ),
        Parameter(
            name="friction", default=0.8, unit="", lower=0.0, upper=10.0, meaning="Coulomb coefficient"
        ),
        Parameter(
            name="effort",
            default=None,
            unit="N m",
            lower=0.0,
            upper=1e4,
            meaning="torque limit (default: the URDF's)",
        ),
    ),
    build=build,
)
