"""What problems of bipeds share: the robot on its legs alone, costs and limits, places of the feet."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from trajopt.reduced.base_path import BaseWaypoint
from trajopt.robot.legs import biped_legs
from trajopt.robot.robot import Robot
from trajopt.schedule.schedule import Motion
from trajopt.terms import PositionLimits, Term, TrackingCost, VelocityLimits
from trajopt_library import robots

from . import common

ROBOTS = ("talos", "g1", "bolt")
# Price of accelerations, for smooth motions.
ACCELERATION = 1e-2
# Price of the base's distance from where it should be: a tenth of that of torques.
TRACKING = 0.1


@lru_cache(maxsize=8)
def biped(name: str) -> Robot:
    """The robot of that name on its two feet, every joint that carries no leg locked at the reference.

    Arms, a waist, a head move nothing that these tasks ask for: they are dead weight on the trunk. Raises
    InputError for a robot that is no biped.
    """
    robot = robots.load(name)
    biped_legs(robot)
    return robots.legs_only(robot)


def limits(robot: Robot, effort_share: float) -> tuple[Term, ...]:
    """Torques, joints and rates within limits, contact wrenches within their cones."""
    return (
        common.share_of_effort(robot, effort_share),
        PositionLimits(),
        VelocityLimits(),
        *common.contact_cones(robot),
    )


def near(motion: Motion) -> Term:
    """Keeps the base, which has no price otherwise, near that of a motion."""
    return TrackingCost(reference=motion, part="base", weight=TRACKING)


def waypoint(robot: Robot, time: float, shift: tuple[float, float, float]) -> BaseWaypoint:
    """The reference's base at ``time`` s, displaced by ``shift`` m in the world."""
    return BaseWaypoint(time=time, position=robot.reference[:3] + np.array(shift))
