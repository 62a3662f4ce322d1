"""The tasks as problems of ours: the same robot, posture, schedule, footholds and heights.

Friction, limits of joints and torques, footholds, swing heights and landing without impact are constraints.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from scripts.peers.objective import EndCost, LandedAtEnd, StateCost
from scripts.peers.tasks import ANYMAL_FEET, Gait, Jump, Task
from trajopt.problem import Problem
from trajopt.reduced.base_path import BaseWaypoint
from trajopt.reduced.legged import legged_guess
from trajopt.robot import Contact, Robot
from trajopt.robot.kinematics import contact_positions
from trajopt.schedule import Phase, Schedule, middle_of
from trajopt.schedule.schedule import Motion
from trajopt.terms import AccelerationCost, FrameHeight, Term, TorqueCost, WrenchCost
from trajopt.terrain.flat import FlatGround
from trajopt.transcription.mesh import Mesh
from trajopt_library import problems, robots
from trajopt_library.problems import common

FRICTION = 0.7
# Guesses of swings are higher than required by this factor.
HIGHER = 1.1
# In the guess of a jump: rise of the base while the legs extend, and fraction of the way at each end on the
# ground.
TAKEOFF_RISE, GROUND_PART = 0.04, 0.1
# Phases up to this duration, s, are one interval; all others have the number that is asked for.
SHORT = 0.06


def build(task: Task) -> Problem:
    """The problem of a task."""
    if isinstance(task, Gait):
        return _gait(task)
    if task.robot == "solo12":
        times = {"stance": task.ground, "flight": task.flight, "landing": task.ground}
        times |= {"distance": task.distance[0], "torque_limit": task.torque_limit}
        return problems.load("solo12-jump", **times)
    return _jump(task)


def mesh(problem: Problem, scheme: str, intervals: int) -> Mesh:
    """``intervals`` in every phase but the short ones."""
    return Mesh.uniform(scheme, [1 if p.duration <= SHORT else intervals for p in problem.schedule.phases])


def anymal() -> Robot:
    """ANYmal B on points at its foot frames, as in Crocoddyl's examples: no balls."""
    known = robots.load("anymal_b")
    model = pin.Model(known.model)
    entries = zip(model.names, model.joints, strict=True)
    posture = {name: known.reference[joint.idx_q] for name, joint in entries if joint.nq == 1}
    contacts = [Contact(frame=f"{leg}_FOOT", name=leg) for leg in ANYMAL_FEET]
    return Robot.from_model(model, name="anymal_b", base="freeflyer", contacts=contacts, reference=posture)


@dataclass(frozen=True, kw_only=True)
class _Steps:
    """Phases, waypoints of the base, and where the feet of the last swing land when the schedule ends."""

    phases: tuple[Phase, ...]
    waypoints: tuple[BaseWaypoint, ...]
    last: dict[str, np.ndarray]


def _steps(task: Gait, robot: Robot) -> _Steps:
    """A step moves the base by its length times the share of feet that step, as Crocoddyl's CoM task."""
    places, landing = dict(contact_positions(robot, robot.reference)), dict[str, np.ndarray]()
    base, time, phases = robot.reference[:3].copy(), 0.0, list[Phase]()
    waypoints = [BaseWaypoint(time=0.0, position=base)]

    def add(name: str, duration: float, contacts: tuple[str, ...]) -> None:
        nonlocal time
        phases.append(Phase(name=name, duration=duration, contacts=contacts, footholds=landing))
        time += duration
        waypoints.append(BaseWaypoint(time=time, position=base))

    for number, block in enumerate(task.blocks):
        add(f"support {number + 1}", task.support, ANYMAL_FEET)
        landing = {}
        for feet in block:
            length = task.length * (task.first if number == 0 else 1.0)
            way = np.array([length, 0.0, 0.0])
            base = base + way * len(feet) / len(ANYMAL_FEET)
            add(f"swing {' '.join(feet)}", task.step, tuple(foot for foot in ANYMAL_FEET if foot not in feet))
            landing = {foot: places[foot] + way for foot in feet}
            places |= landing
    return _Steps(phases=tuple(phases), waypoints=tuple(waypoints), last=landing)


def _gait(task: Gait) -> Problem:
    robot = anymal()
    steps = _steps(task, robot)
    schedule = Schedule(steps.phases)
    guess = legged_guess(robot, schedule, steps.waypoints, clearance=HIGHER * task.height)
    landed = LandedAtEnd(places={robot.contact(foot).frame: place for foot, place in steps.last.items()})
    end = EndCost(weight=1.0, posture=robot.reference)
    return _problem(task, robot, schedule, guess, clearance=task.height, more=(landed, end))


def _jump(task: Jump) -> Problem:
    robot, way = anymal(), np.array(task.distance)
    footholds = {foot: place + way for foot, place in contact_positions(robot, robot.reference).items()}
    schedule = common.hop_schedule(footholds, (task.ground, task.flight, task.ground))
    begin, rise = robot.reference[:3], np.array([0.0, 0.0, TAKEOFF_RISE])
    poses = (
        (0.0, begin),
        (task.ground, begin + GROUND_PART * way + rise),
        (task.ground + task.flight, begin + (1 - GROUND_PART) * way + rise),
        (schedule.duration, begin + way),
    )
    waypoints = [BaseWaypoint(time=time, position=position) for time, position in poses]
    guess = legged_guess(robot, schedule, waypoints)
    height = FrameHeight(frame=robot.model.names[1], height=begin[2] + task.height, at=middle_of("flight"))
    end = EndCost(weight=1.0, posture=robot.reference, place=tuple(begin + way))
    return _problem(task, robot, schedule, guess, clearance=common.CLEARANCE, more=(height, end))


def _problem(
    task: Task, robot: Robot, schedule: Schedule, guess: Motion, *, clearance: float, more: tuple[Term, ...]
) -> Problem:
    costs = (
        TorqueCost(weight=1.0),
        AccelerationCost(weight=1e-2),
        WrenchCost(weight=1e-2),
        StateCost(weight=1.0, posture=robot.reference, path=guess),
    )
    given = {"terrain": FlatGround(friction=FRICTION), "clearance": clearance, "more": more, "end": ()}
    return common.problem(f"crocoddyl-{task.name}", robot, schedule, guess, costs=costs, **given)
