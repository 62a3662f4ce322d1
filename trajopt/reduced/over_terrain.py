"""Gaits over terrain: footholds on its faces, a base path that follows the ground, and a guess.

The base keeps its reference height above the plane that best fits the ground under the feet, and leans with
that plane.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.arguments import checked
from trajopt.dynamics.model_quantities import gravity_of
from trajopt.errors import InputError
from trajopt.problem.contact_paths import Stance
from trajopt.reduced.base_path import BaseWaypoint, WaypointPath, flights, turn_to_heading
from trajopt.reduced.gaits import Pace, base_pose, gait_path, with_footholds
from trajopt.reduced.legged import dropped_onto, legged_guess, stances_under
from trajopt.robot.kinematics import contact_positions, inverse_kinematics
from trajopt.robot.legs import require_free_flyer
from trajopt.robot.robot import Robot
from trajopt.schedule.placing import placed_on
from trajopt.schedule.schedule import Motion, Phase, Schedule
from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.surface import frame_of_normal
from trajopt.terrain.swing_paths import swing_path
from trajopt.terrain.terrain import Terrain

# Largest distance of the feet from their initial places, over the robot's length, in a valid start posture.
REACHED = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class TerrainPlan:
    """A ``schedule`` with landings on terrain, its ``start`` posture (nq,) and ``guess`` ``t -> q`` (nq,)."""

    schedule: Schedule
    start: np.ndarray
    guess: Motion


@checked
def plan_over_terrain(
    robot: Robot, schedule: Schedule, pace: Pace, terrain: Terrain, *, clearance: float, free: bool = False
) -> TerrainPlan:
    """Return the plan of a gait over terrain that starts from standing.

    Feet land under their hips at mid-stance (`gaits`), moved to the nearest point of the terrain that keeps
    the margin from edges. They start vertically above or below their reference positions.

    Args:
        robot: The robot.
        schedule: Contacts over time, without flights.
        pace: Commanded motion of the base.
        terrain: The ground.
        clearance: Least swing height, m, also over edges; the guess swings higher (`swing_path`).
        free: Let the optimisation choose footholds: on the planned face, or anywhere on ground without
            faces. Only the last landing of each foot is fixed, so that the motion ends in the posture of the
            guess.

    Raises:
        InputError: If the gait has flights, or the legs do not reach the ground at the start.
    """
    require_free_flyer(robot)
    if flights(schedule):
        raise InputError("a gait over terrain flies", "allowed: feet on the ground at all times")
    level_path = gait_path(robot, schedule, pace)
    level = with_footholds(robot, schedule, level_path)
    held = replace(level.phases[0], footholds={})  # these contacts stay where they are at the start
    later = level.phases[1:]
    if isinstance(terrain, PiecewiseTerrain):
        later = tuple(_over_faces(phase, terrain) for phase in later)
    placed = placed_on(Schedule((held, *later)), terrain)
    start = standing_on(robot, terrain)
    swing = swing_path(terrain, clearance, radii={each.name: each.radius for each in robot.contacts})
    path = _path_over(robot, placed, pace, stances_under(robot, placed, level_path, start, terrain))
    guess = legged_guess(robot, placed, path, start=start, terrain=terrain, swing=swing)
    return TerrainPlan(schedule=_freed(placed) if free else placed, start=start, guess=guess)


def _freed(schedule: Schedule) -> Schedule:
    """Remove the footholds of all landings but the last one of each contact."""
    last = {name: i for i, phase in enumerate(schedule.phases) for name in phase.footholds}
    return Schedule(
        tuple(
            replace(phase, footholds={name: p for name, p in phase.footholds.items() if last[name] == i})
            for i, phase in enumerate(schedule.phases)
        )
    )


def standing_on(robot: Robot, terrain: Terrain) -> np.ndarray:
    """Return a posture (nq,) with every contact on the terrain, vertically below or above its reference.

    Raises `InputError` over a hole, and if a leg does not reach.
    """
    feet = {}
    for name, place in contact_positions(robot, robot.reference).items():
        ground = terrain.offset(robot.contact(name).radius)
        feet[name] = dropped_onto(place, ground.surface_at(place).plane_at(place))
    pose = _pose_over(robot, pin.XYZQUATToSE3(robot.reference[:7]), feet)
    q = robot.reference.copy()
    q[:7] = pin.SE3ToXYZQUAT(pose)
    targets = {robot.contact(name).frame: place for name, place in feet.items()}
    posture = inverse_kinematics(robot, q, targets)
    if posture.error > REACHED * robot.length:
        raise InputError(
            f"robot '{robot.name}' does not reach the ground under all its feet, by {posture.error:.3g} m",
            "allowed: ground that is less steep or uneven at the start",
        )
    return posture.q


def _over_faces(phase: Phase, terrain: PiecewiseTerrain) -> Phase:
    """Move footholds over holes to the nearest face."""
    footholds = {}
    for name, place in phase.footholds.items():
        candidates = [face.nearest(place) for face in terrain.faces]
        if terrain.face_at(float(place[0]), float(place[1])) is not None:
            candidates = [place]
        apart = [float(np.linalg.norm((candidate - place)[:2])) for candidate in candidates]
        footholds[name] = candidates[int(np.argmin(apart))]
    return replace(phase, footholds=footholds)


def _path_over(
    robot: Robot, schedule: Schedule, pace: Pace, stances: Mapping[str, Sequence[Stance]]
) -> WaypointPath:
    """Return the base path through all phase boundaries: the pace seen from above, over the ground."""
    waypoints, before = [], np.eye(3)
    for time in np.cumsum([0.0, *(phase.duration for phase in schedule.phases)]):
        under = {}
        for name, held in stances.items():  # during swings on the straight line between footholds
            times = np.ravel([(stance.begin, stance.end) for stance in held])
            places = np.repeat([stance.pose.translation for stance in held], 2, axis=0)
            under[name] = np.array([np.interp(time, times, axis) for axis in places.T])
        pose = _pose_over(robot, base_pose(robot, pace, float(time)), under)
        turn = pin.log3(pose.rotation @ before.T)
        waypoints.append(BaseWaypoint(time=float(time), position=pose.translation, turn=turn))
        before = pose.rotation
    return WaypointPath(schedule, waypoints, gravity_of(robot.model))


def _pose_over(robot: Robot, level: pin.SE3, feet: Mapping[str, np.ndarray]) -> pin.SE3:
    """Raise and tilt the ``level`` base pose with the plane that best fits the ``feet`` (3,) m.

    Heights relative to the reference feet are fitted by a + b x + c y along the base's heading (least
    squares; minimum norm if all feet are on one line). The base rises by a and leans by atan b and atan c.
    """
    reference = contact_positions(robot, robot.reference)
    names = sorted(feet)
    turn = turn_to_heading(level.rotation)
    local = np.array([turn.T @ (feet[name] - level.translation) for name in names])
    rises = np.array([feet[name][2] - reference[name][2] for name in names])
    columns = np.column_stack([np.ones(len(names)), local[:, :2] / robot.length])
    offset, ahead, left = np.linalg.lstsq(columns, rises, rcond=None)[0]
    normal = np.array([-ahead / robot.length, -left / robot.length, 1.0])
    lean = frame_of_normal(normal / np.linalg.norm(normal))
    position = level.translation + np.array([0.0, 0.0, offset])
    return pin.SE3(turn @ lean @ turn.T @ level.rotation, position)
