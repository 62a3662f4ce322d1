"""Talos lays its left hand on a wall and pushes, or takes a handle on it and pulls, and comes to rest."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

import robots
from robots.talos import HAND, SIDES, SOLES
from trajopt.family import Family, Parameter
from trajopt.kinematics import inverse_kinematics
from trajopt.node_terms import TerminalRest
from trajopt.problem import Problem
from trajopt.robot import Robot
from trajopt.schedule import FlatGround, Phase, Schedule
from trajopt.surface import Surface
from trajopt.terms import (
    AccelerationCost,
    EffortLimits,
    FrictionCone,
    NormalForce,
    PositionLimits,
    PostureCost,
    SoleCone,
    Term,
    TorqueCost,
    VelocityCost,
    VelocityLimits,
    WrenchCost,
)

# Where the hand goes across, m: in front of the left shoulder.
ACROSS = 0.3
# The force may grow from touch to its full value for this part of the reach's duration.
LOADING_SHARE = 0.5


def _leaning(robot: Robot, hand: np.ndarray, push: np.ndarray) -> np.ndarray:
    """Posture with both soles where they stand and the hand at its place, leaning into the push.

    The centre of mass is moved by what balances the moment of ``push`` (3,) N on the hand about the ground.
    """
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    targets: dict[str, pin.SE3 | np.ndarray] = {
        frame: data.oMf[robot.model.getFrameId(frame)].copy() for frame in SOLES.values()
    }
    leaning = robot.reference.copy()
    leaning[0] -= push[0] * hand[2] / robot.weight
    return inverse_kinematics(robot, leaning, targets | {HAND: hand}, move_base=True).q


class _Guess:
    """From standing to leaning along 10 s^3 - 15 s^4 + 6 s^5, soles kept in place by the legs, then still."""

    def __init__(self, robot: Robot, end: np.ndarray, duration: float) -> None:
        self.robot, self.end, self.duration = robot, end, duration
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.reference)
        self.soles = {frame: data.oMf[robot.model.getFrameId(frame)].copy() for frame in SOLES.values()}

    def __call__(self, t: float) -> np.ndarray:
        s = min(max(t / self.duration, 0.0), 1.0)
        smooth = s**3 * (10 - 15 * s + 6 * s * s)
        between = pin.interpolate(self.robot.model, self.robot.reference, self.end, smooth)
        return inverse_kinematics(self.robot, between, self.soles).q


def _wall(distance: float, height: float, tilt: float, friction: float, held: bool) -> Surface:
    """Plane through the hand's place; a positive tilt turns its top away from the robot."""
    normal = np.array([-math.cos(tilt), 0.0, math.sin(tilt)])
    point = np.array([distance, ACROSS, height])
    return Surface(point=point, normal=normal, friction=friction, bilateral=held)


def _terms(force: float, end: np.ndarray) -> tuple[Term, ...]:
    bounds = {"lower": force} if force >= 0 else {"upper": force}
    return (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=1e-2),
        VelocityCost(weight=1e-2),
        PostureCost(weight=1e-1),
        WrenchCost(weight=1e-2),
        EffortLimits(),
        PositionLimits(),
        VelocityLimits(),
        SoleCone(),
        FrictionCone(contacts=("hand",)),
        NormalForce(contact="hand", phases=("push",), **bounds),
        TerminalRest(q=end),
    )


def build(
    *,
    distance: float,
    height: float,
    tilt: float,
    force: float,
    reach: float,
    push: float,
    friction: float,
    wall_friction: float,
) -> Problem:
    """Build the problem; see ``FAMILY`` for the parameters. Raises InputError."""
    robot = robots.load("talos")
    wall = _wall(distance, height, tilt, wall_friction, held=force < 0)
    end = _leaning(robot, wall.point, force * wall.normal)
    touching = {"contacts": (*SIDES, "hand"), "surfaces": {"hand": wall}}
    return Problem(
        name="talos-wall",
        robot=robot,
        schedule=Schedule(
            (
                Phase(name="reach", duration=reach, contacts=SIDES),
                Phase(
                    name="touch",
                    duration=LOADING_SHARE * reach,
                    footholds={"hand": wall.point},
                    **touching,
                ),
                Phase(name="push", duration=push, **touching),
            )
        ),
        terrain=FlatGround(friction=friction),
        initial_q=robot.reference,
        initial_v=np.zeros(robot.nv),
        terms=_terms(force, end),
        guess=_Guess(robot, end, reach),
        default_intervals=20,
    )


FAMILY = Family(
    name="talos-wall",
    robot="talos",
    phases=("reach", "touch", "push"),
    summary="lean on a wall with one hand and push, or hold a handle on it and pull, at rest at the end",
    parameters=(
        Parameter(
            name="distance", default=0.55, unit="m", lower=0.2, upper=1.2, meaning="of the wall, forward"
        ),
        Parameter(
            name="height", default=1.2, unit="m", lower=0.5, upper=1.8, meaning="of the hand on the wall"
        ),
        Parameter(
            name="tilt", default=0.0, unit="rad", lower=-0.6, upper=0.6, meaning="of the wall's top, away"
        ),
        Parameter(
            name="force",
            default=80.0,
            unit="N",
            lower=-300.0,
            upper=300.0,
            meaning="least push along the wall's normal; negative: least pull at a handle, a bilateral grasp",
        ),
        Parameter(
            name="reach", default=0.8, unit="s", lower=1e-2, upper=10.0, meaning="duration until touch"
        ),
        Parameter(name="push", default=0.4, unit="s", lower=1e-2, upper=10.0, meaning="duration of the push"),
        Parameter(
            name="friction", default=0.7, unit="", lower=0.0, upper=10.0, meaning="coefficient of the ground"
        ),
        Parameter(
            name="wall_friction",
            default=0.5,
            unit="",
            lower=0.0,
            upper=10.0,
            meaning="coefficient of the wall",
        ),
    ),
    build=build,
)
