"""Talos lays its left hand on a wall and pushes, or takes a handle on it and pulls, and comes to rest."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.problem.family import Family, Parameter
from trajopt.problem.problem import Problem
from trajopt.robot.kinematics import frame_pose, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.terms import (
    EffortLimits,
    FrictionCone,
    NormalForce,
    PositionLimits,
    SoleCone,
    Term,
    TerminalRest,
    VelocityLimits,
)
from trajopt.terrain.flat import FlatGround
from trajopt.terrain.surface import Surface
from trajopt.terrain.swing_profile import smooth_step
from trajopt_library import robots
from trajopt_library.robots.talos import HAND, SIDES, SOLES

from . import common

# Where the hand goes across, m: in front of the left shoulder.
ACROSS = 0.3
# The force may grow from touch to its full value for this part of the reach's duration.
LOADING_SHARE = 0.5


def _leaning(robot: Robot, hand: np.ndarray, push: np.ndarray) -> np.ndarray:
    """Posture with both soles where they stand and the hand at its place, leaning into the push.

    The centre of mass is moved by what balances the moment of ``push`` (3,) N on the hand about the ground.
    """
    leaning = robot.reference.copy()
    leaning[0] -= push[0] * hand[2] / robot.weight
    return inverse_kinematics(robot, leaning, {**_soles(robot), HAND: hand}, move_base=True).q


def _soles(robot: Robot) -> dict[str, pin.SE3]:
    return {frame: frame_pose(robot, robot.reference, frame) for frame in SOLES.values()}


class _Guess:
    """From standing to leaning along 10 s^3 - 15 s^4 + 6 s^5, soles kept in place by the legs, then still."""

    def __init__(self, robot: Robot, end: np.ndarray, duration: float) -> None:
        self.robot, self.end, self.duration, self.soles = robot, end, duration, _soles(robot)

    def __call__(self, t: float) -> np.ndarray:
        s = smooth_step(t / self.duration)
        between = pin.interpolate(self.robot.model, self.robot.reference, self.end, s)
        return inverse_kinematics(self.robot, between, self.soles).q


def _wall(distance: float, height: float, tilt: float, friction: float, held: bool) -> Surface:
    """Plane through the hand's place; a positive tilt turns its top away from the robot."""
    point = np.array([distance, ACROSS, height])
    return Surface(point=point, normal=common.wall_normal(tilt), friction=friction, bilateral=held)


def _terms(force: float, end: np.ndarray) -> tuple[Term, ...]:
    bounds = {"lower": force} if force >= 0 else {"upper": force}
    return (
        *common.legged_costs(acceleration=1e-2),
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
        common.length("distance", 0.55, "of the wall, forward", (0.2, 1.2)),
        common.length("height", 1.2, "of the hand on the wall", (0.5, 1.8)),
        common.angle("tilt", 0.0, "of the wall's top, away", (-0.6, 0.6)),
        Parameter(
            name="force",
            default=80.0,
            unit="N",
            lower=-300.0,
            upper=300.0,
            meaning="least push along the wall's normal; negative: least pull at a handle, a bilateral grasp",
        ),
        common.duration("reach", 0.8, "duration until touch", (1e-2, 10.0)),
        common.duration("push", 0.4, "duration of the push", (1e-2, 10.0)),
        common.friction(0.7, meaning="coefficient of the ground"),
        common.friction(0.5, "wall_friction", "coefficient of the wall"),
    ),
    build=build,
)
