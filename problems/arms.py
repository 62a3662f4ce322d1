"""What families for any arm share: the arm and its tool, poses as its reach measures them, paths, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import robots
from trajopt.actuators.terms import DriveLimits
from trajopt.errors import InputError
from trajopt.kinematics import Posture, frame_pose, inverse_kinematics
from trajopt.reduced.foot_motion import smooth_step
from trajopt.robot import Robot
from trajopt.terms import EffortLimits, PositionLimits, Term, VelocityLimits

# Arms on which families are tested; any other works by its name or file.
ARMS = ("ur5", "panda", "kinova", "irb1600", "z1", "xarm7")
# Inverse kinematics follows the tool in steps, so that the branch of the reference is kept.
STEPS = 12
# A pose is reached up to this error, m and rad.
REACHED = 1e-6
# Peak rate and acceleration of the guess, 10 s^3 - 15 s^4 + 6 s^5, over a unit of time.
PEAK_RATE, PEAK_ACCELERATION = 1.875, 10 / math.sqrt(3)


@dataclass(frozen=True, kw_only=True)
class Arm:
    """An arm and the name of its tool frame."""

    robot: Robot
    tool: str

    @property
    def axis(self) -> np.ndarray:
        """Where the first joint is, (3,) m, world: headings turn about the vertical through it."""
        return np.array(self.robot.model.jointPlacements[1].translation)

    @property
    def at_reference(self) -> pin.SE3:
        """Pose of the tool in the reference posture, world."""
        return frame_pose(self.robot, self.robot.reference, self.tool)

    def pose(self, turn: float, out: float, up: float) -> pin.SE3:
        """The tool's pose in the reference, turned about the vertical and moved.

        turn: rad, to the left, orientation included. out, up: away from the axis and upwards, as parts of
        the arm's reach.
        """
        reference, about = self.at_reference, pin.rpy.rpyToMatrix(0.0, 0.0, turn)
        x, y, z = reference.translation - self.axis
        radius = math.hypot(x, y)
        outwards = np.array([x / radius, y / radius, 0.0]) if radius > 0 else np.array([1.0, 0.0, 0.0])
        moved = np.array([x, y, z + up * self.robot.length]) + out * self.robot.length * outwards
        return pin.SE3(about @ reference.rotation, self.axis + about @ moved)

    def cylinder(self, position: np.ndarray) -> tuple[float, float, float]:
        """The (turn, out, up) whose `pose` is at ``position`` (3,) m, world."""
        here, there = self.at_reference.translation - self.axis, np.asarray(position) - self.axis
        turn = math.atan2(there[1], there[0]) - math.atan2(here[1], here[0])
        turn = math.remainder(turn, 2 * math.pi)
        out = math.hypot(there[0], there[1]) - math.hypot(here[0], here[1])
        return turn, out / self.robot.length, (there[2] - here[2]) / self.robot.length

    def follow(self, turn: float, out: float, up: float) -> Posture:
        """Posture with the tool at that `pose`, followed from the reference in steps; as near as it gets."""
        posture = Posture(self.robot.reference, 0.0)
        for part in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
            goal = self.pose(part * turn, part * out, part * up)
            posture = inverse_kinematics(self.robot, posture.q, {self.tool: goal})
        return posture

    def posture(self, turn: float, out: float, up: float) -> np.ndarray:
        """The posture (nq,) of `follow`. Raises InputError where the arm does not get there."""
        found = self.follow(turn, out, up)
        if found.error > REACHED:
            x, y, z = self.pose(turn, out, up).translation
            raise InputError(
                f"'{self.robot.name}' does not bring '{self.tool}' to ({x:.3f}, {y:.3f}, {z:.3f}) m,"
                f" turned by {math.degrees(turn):.0f} degrees",
                f"allowed: poses within its reach ({self.robot.length:.2f} m) and joint ranges",
            )
        return found.q


@dataclass(frozen=True, kw_only=True)
class ArmPath:
    """Guess: from ``start`` to ``end`` (nq,) along 10 s^3 - 15 s^4 + 6 s^5 in ``duration`` s, then still."""

    model: pin.Model
    start: np.ndarray
    end: np.ndarray
    duration: float

    def __call__(self, t: float) -> np.ndarray:
        return np.asarray(pin.interpolate(self.model, self.start, self.end, smooth_step(t / self.duration)))


def load(name: str) -> Arm:
    """Return the arm of that name. Raises InputError for what is no arm, or an arm without torque limits."""
    tool = robots.tool_frame(name)
    return Arm(robot=robots.load(name), tool=tool)


def least_duration(robot: Robot, start: np.ndarray, end: np.ndarray) -> float:
    """Duration of a guess between two postures (nq,), s: what rates allow, and torques less gravity's.

    As if each joint moved its own inertia alone: an estimate for a start of the search, not a bound.
    """
    model, data = robot.model, robot.model.createData()
    travel = np.abs(pin.difference(model, start, end))
    by_rate = PEAK_RATE * travel / robot.velocity_limit
    if robot.effort_limit is None:
        return float(by_rate.max())
    left = [robot.effort_limit - np.abs(pin.computeGeneralizedGravity(model, data, q)) for q in (start, end)]
    # An end that the motors do not hold leaves the problem infeasible, and the guess as it may be.
    spare = np.maximum(np.min(left, axis=0), LEAST_SPARE * robot.effort_limit)
    acceleration = spare / np.diag(pin.crba(model, data, start))
    by_torque = np.sqrt(PEAK_ACCELERATION * travel / acceleration)
    return float(max(by_rate.max(), by_torque.max()))


# Part of a motor's torque that is taken to be left for the motion, at least.
LEAST_SPARE = 0.1


def limits(robot: Robot) -> tuple[Term, ...]:
    """Limits of torques (of the drives where the robot has them), positions and rates."""
    effort = EffortLimits() if robot.drives is None else DriveLimits()
    return (effort, PositionLimits(), VelocityLimits())
