"""Talos puts its left hand on a wall and pushes, or grasps a handle on it and pulls, and comes to rest."""

from typing import Any

import numpy as np

from trajopt.problem import Family, Problem, posture_guess
from trajopt.robot import Robot, frame_pose, inverse_kinematics
from trajopt.schedule import Phase, Schedule
from trajopt.terms import FrictionCone, NormalForce, SoleCone, TerminalRest
from trajopt.terrain import Surface
from trajopt_library import robots
from trajopt_library.robots.talos import HAND, SIDES, SOLES

from . import common

# Lateral position of the hand, m: in front of the left shoulder.
ACROSS = 0.3
# Time in which the force may grow from zero to its full value, over the duration of the reach.
LOADING_SHARE = 0.5


def _leaning(robot: Robot, hand: np.ndarray, push: np.ndarray) -> np.ndarray:
    """Return a posture with both soles in place and the hand at its goal, leaning into the push.

    The centre of mass moves to balance the moment of ``push`` (3,) N at the hand about the ground.
    """
    leaning = robot.reference.copy()
    leaning[0] -= push[0] * hand[2] / robot.weight
    soles = {frame: frame_pose(robot, robot.reference, frame) for frame in SOLES.values()}
    return inverse_kinematics(robot, leaning, {**soles, HAND: hand}, move_base=True).q


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
    place, normal = np.array([distance, ACROSS, height]), common.wall_normal(tilt)
    wall = Surface(point=place, normal=normal, friction=wall_friction, bilateral=force < 0)
    end = _leaning(robot, wall.point, force * wall.normal)
    touching: dict[str, Any] = {"contacts": (*SIDES, "hand"), "surfaces": {"hand": wall}}
    loading = LOADING_SHARE * reach
    bounds = {"lower": force} if force >= 0 else {"upper": force}
    schedule = Schedule(
        (
            Phase(name="reach", duration=reach, contacts=SIDES),
            Phase(name="touch", duration=loading, footholds={"hand": wall.point}, **touching),
            Phase(name="push", duration=push, **touching),
        )
    )
    return common.problem(
        "talos-wall",
        robot,
        schedule,
        posture_guess(robot, schedule, (robot.reference, end, end, end)),
        cones=(
            SoleCone(),
            *([] if wall.bilateral else [FrictionCone(contacts=("hand",))]),
            NormalForce(contact="hand", during="push", **bounds),
        ),
        friction=friction,
        end=(TerminalRest(q=end),),
        default_intervals=20,
    )


FAMILY = Family(
    name="talos-wall",
    robot="talos",
    phases=("reach", "touch", "push"),
    summary="lean on a wall with one hand and push, or hold a handle on it and pull, at rest at the end",
    parameters=(
        common.length("distance", 0.55, "distance of the wall ahead", (0.2, 1.2)),
        common.length("height", 1.2, "height of the hand on the wall", (0.5, 1.8)),
        common.angle("tilt", 0.0, "tilt of the wall, positive: top away", (-0.6, 0.6)),
        common.number(
            "force",
            80.0,
            "N",
            "least push along the wall's normal; negative: least pull at a handle, a bilateral grasp",
            (-300.0, 300.0),
        ),
        common.duration("reach", 0.8, "duration until touchdown of the hand", (1e-2, 10.0)),
        common.duration("push", 0.4, "duration of the push", (1e-2, 10.0)),
        common.friction(0.7, meaning="friction coefficient of the ground"),
        common.friction(0.5, "wall_friction", "friction coefficient of the wall"),
    ),
    build=build,
)
