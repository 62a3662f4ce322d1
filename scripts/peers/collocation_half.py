"""Our half of `scripts/compare_collocation.py`: requests as lines of JSON on stdin, answers on stdout.

{"do": "describe", "task": "ur5"}                                     what all sides state alike
{"do": "solve", "task": "ur5", "method": "legendre:3", "intervals": 8}    see `scripts.peers.plans`

A task takes a robot from rest to rest in a fixed time with the least integral of squared torques. The guess
is straight in angles. Functions are compiled before a solve, and no time counts that.
"""

from dataclasses import replace
from functools import cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from scripts.peers.halves import answer
from scripts.peers.plans import Stopwatch, plan, times_told
from trajopt.motion.quantities import MotionQuantities
from trajopt.problem.problem import Problem
from trajopt.robot import Robot, robot_file
from trajopt.schedule import Phase, Schedule
from trajopt.solvers.result import StoppingCriteria
from trajopt.solving.solving import PreparedProblem, prepare, solve_prepared
from trajopt.terms import (
    PositionLimits,
    TerminalRest,
    TerminalState,
    TorqueCost,
    TorqueLimits,
    VelocityLimits,
)
from trajopt_library import problems

# Descriptions that the other sides read, too, without what is not dynamics of rigid bodies.
FILES = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "acrobot": "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
}
LEFT_OUT = {"visual", "collision", "dynamics", "transmission", "gazebo"}
# Problems of the library with this robot.
PROBLEMS = {"ur5": "ur5-reach", "acrobot": "acrobot", "cart-pole": "cart-pole"}
# Duration of the arm's motion, s: three of its joints run at their limits of rates.
ARM_DURATION = 0.8
# Largest rates of the acrobot, rad/s: without a limit its second link spins, for that takes less torque.
ACROBOT_RATE = 15.0
# Of its torque, as in the library's problem.
ACROBOT_SHARE = 0.5
# In natural units. At the default of 1e-6 the torques of the arm's wrist, small beside its weight, are not
# optimal yet, and the objective is up to 0.3 % too large.
STOP = StoppingCriteria(tolerance=1e-8)
# Pinocchio writes its largest number for "no limit".
UNLIMITED = 1e100


def _pendulum() -> Robot:
    """Betts' pendulum (example 10.103) by its angle: zero is level, towards x; 1 kg at 1 m."""
    model = pin.Model()
    model.name = "pendulum"
    turn = pin.JointModelRevoluteUnaligned(0.0, -1.0, 0.0)
    swing = model.addJoint(0, turn, pin.SE3.Identity(), "swing")
    model.addJointFrame(swing)
    tip = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.appendBodyToJoint(swing, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), tip)
    model.addFrame(pin.Frame("tip", swing, 0, tip, pin.FrameType.OP_FRAME))
    return Robot.from_model(model)


@cache
def _robot(task: str) -> tuple[Robot, float, np.ndarray, np.ndarray]:
    """Robot, duration in s, first and last positions (nv,), angles where Pinocchio has cosine and sine."""
    if task == "pendulum":
        return _pendulum(), 3.0, np.zeros(1), np.array([-np.pi / 2])
    known = problems.load(PROBLEMS[task])
    robot, duration = known.robot, known.schedule.duration
    if task == "acrobot":
        limits = {
            "torque_limit": ACROBOT_SHARE * robot.torque_limit,
            "velocity_limit": np.full(robot.nv, ACROBOT_RATE),
        }
        return replace(robot, **limits), duration, np.array([np.pi, 0.0]), np.zeros(2)
    return robot, ARM_DURATION if task == "ur5" else duration, robot.reference, known.guess_at(duration)


@cache
def _problem(task: str) -> Problem:
    robot, duration, first, last = _robot(task)

    def straight(t: float) -> np.ndarray:
        return np.asarray(pin.integrate(robot.model, robot.reference, t / duration * (last - first)))

    end = straight(duration)
    limits = (TorqueLimits(), PositionLimits(), VelocityLimits())
    return Problem(
        name=task,
        robot=robot,
        schedule=Schedule((Phase(name="motion", duration=duration),)),
        terms=(TorqueCost(weight=1.0), *limits, TerminalState(q=end), TerminalRest(q=end)),
        guess=straight,
    )


@cache
def _prepared(task: str, method: str, intervals: int) -> tuple[PreparedProblem, float]:
    with Stopwatch() as watch:
        prepared = prepare(_problem(task), transcription=method, intervals=intervals)
    return prepared, watch.seconds - prepared.compilation.compile_time


def describe(task: str) -> dict[str, Any]:
    """Robot, ends, limits and duration; None stands for no limit."""
    robot, duration, first, last = _robot(task)
    names = [robot.model.names[joint.id] for joint in robot.model.joints[1:]]
    angles = robot.nq > robot.nv
    limits = {
        "torque": np.full(robot.nu, np.inf) if robot.torque_limit is None else robot.torque_limit,
        "rate": robot.velocity_limit,
        "lower": np.full(robot.nv, -np.inf) if angles else robot.position_lower,
        "upper": np.full(robot.nv, np.inf) if angles else robot.position_upper,
    }
    return {
        "name": task,
        "urdf": _description(FILES[task]) if task in FILES else None,
        "joints": names,
        "actuated": [name for name in names if name not in robot.passive],
        "duration": duration,
        "first": first.tolist(),
        "last": last.tolist(),
        **{
            name: [value if abs(value) < UNLIMITED else None for value in values.tolist()]
            for name, values in limits.items()
        },
    }


def _description(path: str) -> str:
    tree = ElementTree.parse(robot_file(path)).getroot()
    for parent in list(tree.iter()):
        for child in [child for child in parent if child.tag in LEFT_OUT]:
            parent.remove(child)
    return ElementTree.tostring(tree, encoding="unicode")


def solve(task: str, method: str, intervals: int) -> dict[str, Any]:
    """Solve from the guess; the processor's time counts that of reading the solution."""
    prepared, build = _prepared(task, method, intervals)
    with Stopwatch() as watch:
        found = solve_prepared(prepared, prepared.guess, origin={}, judge=False, stop=STOP)
    watch.seconds = found.statistics.wall_time_s
    breaks = np.append(found.interval_t[:, 0], found.interval_t[-1, 1])
    sampled = found.sample(times=times_told(breaks))
    positions = sampled.angle if sampled.angle.size else sampled.q
    return plan(
        build=build,
        watch=watch,
        solved=found.converged,
        breaks=breaks,
        inputs=MotionQuantities(found).inputs,
        times=sampled.t,
        states=np.hstack([positions, sampled.v]),
    )


if __name__ == "__main__":
    answer({"describe": describe, "solve": solve})
