"""An arm moves its tool from one side to the other past a box and a post in its path."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from trajopt.collision import (
    BoxObstacle,
    CapsuleObstacle,
    Obstacle,
    robot_shapes,
)
from trajopt.problem import Family, Parameter, Problem
from trajopt.robot import Robot, frame_pose, inverse_kinematics
from trajopt.terms import AccelerationCost, Clearance, TorqueCost
from trajopt.terrain import smooth_step

from . import arms, common

if TYPE_CHECKING:
    from trajopt.collision import CollisionScene

# Position of the tool at start and goal, over the robot's reach: distance from the base's axis, and height.
RADIUS, HEIGHT = 0.4, 0.25
# Sides of the box along the tool's path and across it, and radius of the post, all over the reach.
BOX_ALONG, BOX_ACROSS, POST_RADIUS = 0.08, 0.2, 0.025
# Positions of box and post between start (-1) and goal (1), as a fraction of the turn.
BOX_AT, POST_AT = -0.3, 0.35
# Steps in which inverse kinematics follow the tool around the base, to stay on the reference's branch.
STEPS = 8
# Steps by which the waypoint is raised, and its largest rise; how far it is drawn in; all over the reach.
RAISE_STEP, MOST_RAISED, DRAWN_IN = 0.02, 0.5, (0.0, 0.05, 0.1)
# Number of configurations at which the clearance of a guess is measured.
LOOKS = 40
# Peak rate of 10 s^3 - 15 s^4 + 6 s^5 over its mean. The default duration allows for a path over the
# obstacles, longer than the turn. Its lower bound, due to the arm's weight, is in units of sqrt(reach / g).
PEAK_RATE, LONGER_WAY, LEAST_TIME = 1.875, 1.5, 5.0
# Weight of accelerations relative to torques. Some motions of a redundant arm need hardly any torque: with a
# tenth of this weight, a seven-joint arm takes three times the iterations.
SMOOTHNESS = 0.1


@dataclass(frozen=True, kw_only=True)
class RaisedPath:
    """Guess: from ``start`` to ``goal`` (nq,) in ``duration`` s, at its middle through ``waypoint`` (nq,).

    In the tangent space of ``start``: the straight path along 10 s^3 - 15 s^4 + 6 s^5, and the detour along
    64 s^3 (1 - s)^3, which starts and ends with neither rate nor acceleration.
    """

    model: pin.Model
    start: np.ndarray
    waypoint: np.ndarray
    goal: np.ndarray
    duration: float

    def __call__(self, t: float) -> np.ndarray:
        """The configuration (nq,) at ``t`` s."""
        s = min(max(t / self.duration, 0.0), 1.0)
        way = pin.difference(self.model, self.start, self.goal)
        detour = pin.difference(self.model, self.start, self.waypoint) - way / 2
        step = smooth_step(s) * way + 64 * (s * (1 - s)) ** 3 * detour
        return np.asarray(pin.integrate(self.model, self.start, step))


def obstacles_of(
    arm: arms.Arm, turn: float, radius: float, height: float, rise: float
) -> tuple[Obstacle, ...]:
    """A box and a post from the ground to ``rise`` m over the tool's height, in the tool's path.

    They stand at `BOX_AT` and `POST_AT` of ``turn`` rad either way, at ``radius`` m from the base's axis.
    """
    reach, top = arm.robot.length, height + rise
    centre = arm.at(BOX_AT * turn, radius, top / 2).translation
    facing = pin.rpy.rpyToMatrix(0.0, 0.0, math.atan2(centre[1], centre[0]))
    thickness = POST_RADIUS * reach
    foot, head = (arm.at(POST_AT * turn, radius, z).translation for z in (thickness, top - thickness))
    return (
        BoxObstacle(
            name="box",
            sides=np.array([BOX_ACROSS * reach, BOX_ALONG * reach, top]),
            position=centre,
            rotation=facing,
        ),
        CapsuleObstacle(name="post", start=foot, end=head, radius=thickness),
    )


def turned(arm: arms.Arm, turn: float, radius: float, height: float) -> np.ndarray:
    """Posture (nq,) at a heading, followed from the reference's in steps. Raises InputError."""
    poses = [arm.at(part * turn, radius, height) for part in np.linspace(0.0, 1.0, STEPS + 1)]
    return arm.reached(arm.follow(poses), poses[-1])


def raised_path(
    arm: arms.Arm, ends: tuple[np.ndarray, np.ndarray], scene: CollisionScene, least: float
) -> RaisedPath:
    """The path with the lowest waypoint that keeps ``least`` m from the obstacles, else the clearest one.

    ends: start and goal (nq,). The duration is 1 s.
    """
    robot, place = arm.robot, frame_pose(arm.robot, ends[0], arm.tool).translation
    radius, height = float(np.hypot(place[0], place[1])), float(place[2])
    middle = turned(arm, 0.0, radius, height)

    def through(waypoint: np.ndarray) -> tuple[float, RaisedPath]:
        path = RaisedPath(model=robot.model, start=ends[0], waypoint=waypoint, goal=ends[1], duration=1.0)
        return clearance_along(scene, path), path

    best = through(middle)
    for step, drawn in product(range(round(MOST_RAISED / RAISE_STEP) + 1), DRAWN_IN):
        raised = step * RAISE_STEP
        target = arm.at(0.0, radius - drawn * robot.length, height + raised * robot.length)
        waypoint = inverse_kinematics(robot, middle, {arm.tool: target})
        if waypoint.error < arms.REACHED:
            best = max(best, through(waypoint.q), key=lambda candidate: candidate[0])
        if best[0] >= least:
            break
    return best[1]


def clearance_along(scene: CollisionScene, path: RaisedPath) -> float:
    """Least distance in m between robot and obstacles along a path, by Coal."""
    times = np.linspace(0.0, path.duration, LOOKS + 1)
    return float(scene.least_distances(path(float(t)) for t in times).min(initial=np.inf))


def _duration(robot: Robot, start: np.ndarray, goal: np.ndarray) -> float:
    """Return the duration in s that the velocity limits allow for the turn, with time for the detour."""
    travel = np.abs(pin.difference(robot.model, start, goal))
    by_rate = LONGER_WAY * PEAK_RATE * float((travel / robot.velocity_limit).max())
    return max(by_rate, LEAST_TIME * math.sqrt(robot.length / 9.81))


def build(
    *,
    robot: str,
    turn: float,
    radius: float,
    height: float,
    rise: float,
    margin: float,
    duration: float | None,
) -> Problem:
    """Build the motion past the obstacles; see ``FAMILY`` for the parameters. Raises InputError."""
    from trajopt.collision import CollisionScene, inertia_boxes, separable_pairs  # slow; not needed to list

    arm = arms.load(robot)
    body, reach = arm.robot, arm.robot.length
    place = (radius * reach, height * reach)
    start, goal = (turned(arm, side * turn, *place) for side in (-1.0, 1.0))
    obstacles = obstacles_of(arm, turn, *place, rise * reach)
    shapes, boxes, pairs = robot_shapes(body).shapes, None, ()
    if not shapes:
        shapes = boxes = inertia_boxes(body.model)
        pairs = separable_pairs(body.model, boxes, body.reference, margin * reach)
    clearance = Clearance(obstacles=obstacles, margin=margin * reach, shapes=boxes)
    scene = CollisionScene(model=body.model, shapes=shapes, obstacles=obstacles, self_pairs=pairs)
    path = raised_path(arm, (start, goal), scene, margin * reach)
    given = _duration(body, start, goal) if duration is None else duration
    problem = arms.between(
        "arm-avoid",
        body,
        (start, goal),
        given,
        phase="pass",
        guess=replace(path, duration=given),
        costs=(TorqueCost(weight=1.0), AccelerationCost(weight=SMOOTHNESS)),
        end=arm.arrival(frame_pose(body, goal, arm.tool), goal),
        parameters={"duration": given},
        default_intervals=30,
    )
    return replace(problem, terms=(*problem.terms, clearance))


def _share(name: str, default: float, meaning: str, within: common.Range) -> Parameter:
    return common.number(name, default, "reach", meaning, within)


FAMILY = Family(
    name="arm-avoid",
    robots=("ur5", "panda", "kinova", "irb1600"),
    phases=("pass",),
    summary="bring the tool past a box and a post in its way, from rest to rest, clear of both",
    parameters=(
        common.angle("turn", math.radians(50), "angle of start and goal to either side", (0.2, math.pi / 2)),
        _share("radius", RADIUS, "distance of the tool from the base's axis at start and goal", (0.1, 1.0)),
        _share("height", HEIGHT, "height of the tool at start and goal", (0.05, 1.0)),
        _share("rise", 0.05, "height of the tops of box and post above the tool", (0.0, 0.5)),
        _share("margin", 0.01, "distance to keep from the obstacles", (0.0, 0.1)),
        common.duration("duration", None, "duration (default: from the velocity limits)", (1e-2, 60.0)),
    ),
    build=build,
)
