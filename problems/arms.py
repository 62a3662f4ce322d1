"""Shared by the families for arms: the arm and its tool, poses relative to its reach, paths, limits."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.collision import robot_shapes
from trajopt.errors import InputError
from trajopt.problem import Parameter, PosturePath, Problem
from trajopt.robot import Posture, Robot, Units, frame_pose, inverse_kinematics, require_moving
from trajopt.schedule import Motion, Phase, Schedule
from trajopt.terms import (
    DriveLimits,
    FramePose,
    Term,
    TerminalRest,
    TorqueLimits,
)
from trajopt.terrain import FlatGround
from trajopt_library import robots

from . import common

# Arms on which families are tested; others work by name or file.
ARMS = ("ur5", "panda", "kinova", "irb1600", "z1", "xarm7")
VARIANTS = {"actuation=jerk": ("ur5", "panda", "z1", "xarm7")}
# Steps in which inverse kinematics follow the tool, to stay on the reference's branch.
STEPS = 12
# Largest error of a pose that is reached, m and rad.
REACHED = 1e-6
# Rows of a pose. An arm with fewer joints reaches few poses; arm-reach may ask for the position alone.
POSE_ROWS, ORIENTATION, GIVEN, FREE = 6, "orientation", "given", "free"
# Least fraction of a motor's torque assumed to be left for the motion.
LEAST_SPARE = 0.1
# Least assumed lever arm between a joint and a force at the tool, over the reach.
LEAST_LEVER = 1e-3
# Least distance behind the tool, m, of the joint that defines the arm's direction.
BEHIND = 1e-3
# Peak rate and acceleration of the guess, 10 s^3 - 15 s^4 + 6 s^5, over a unit of time.
PEAK_RATE, PEAK_ACCELERATION = 1.875, 10 / math.sqrt(3)


@dataclass(frozen=True, kw_only=True)
class Arm:
    """An arm and the name of its tool frame."""

    robot: Robot
    tool: str

    @property
    def axis(self) -> np.ndarray:
        """Position of the first joint, (3,) m, world: headings are about the vertical through it."""
        return np.array(self.robot.model.jointPlacements[1].translation)

    @property
    def at_reference(self) -> pin.SE3:
        """Pose of the tool in the reference posture, world."""
        return frame_pose(self.robot, self.robot.reference, self.tool)

    @property
    def outward(self) -> np.ndarray:
        """Unit axis (3,) of the last joint in the tool's axes, out of the arm: where the tool points."""
        robot, data = self.robot, self.robot.model.createData()
        model, last = robot.model, robot.model.njoints - 1
        pin.computeJointJacobians(model, data, robot.reference)
        column = pin.getJointJacobian(model, data, last, pin.LOCAL_WORLD_ALIGNED)[:, -1]
        turns = bool(np.linalg.norm(column[3:]) > 0)
        axis = np.array(column[3:] if turns else column[:3])
        tool = self.at_reference
        behind = [(tool.translation - data.oMi[joint].translation) @ axis for joint in model.supports[last]]
        side = next((reach for reach in reversed(behind) if abs(reach) > BEHIND), 1.0)
        return np.asarray(tool.rotation.T @ axis * math.copysign(1.0, side))

    def pose(self, turn: float, out: float, up: float) -> pin.SE3:
        """The tool's pose in the reference, turned about the vertical and moved.

        turn: rad, to the left, orientation included. out, up: away from the axis and upwards, over the arm's
        reach.
        """
        reference, about = self.at_reference, pin.rpy.rpyToMatrix(0.0, 0.0, turn)
        x, y, z = reference.translation - self.axis
        radius = math.hypot(x, y)
        outwards = np.array([x / radius, y / radius, 0.0]) if radius > 0 else np.array([1.0, 0.0, 0.0])
        moved = np.array([x, y, z + up * self.robot.length]) + out * self.robot.length * outwards
        return pin.SE3(about @ reference.rotation, self.axis + about @ moved)

    def at(self, turn: float, radius: float, height: float) -> pin.SE3:
        """The tool's pose turned by ``turn`` rad, ``radius`` m from the axis, ``height`` m in the world."""
        _, out, up = self.cylinder(self.axis * [1, 1, 0] + np.array([radius, 0.0, height]))
        return self.pose(turn, out, up)

    def cylinder(self, position: np.ndarray) -> tuple[float, float, float]:
        """The (turn, out, up) whose `pose` is at ``position`` (3,) m, world."""
        here, there = self.at_reference.translation - self.axis, np.asarray(position) - self.axis
        turn = math.atan2(there[1], there[0]) - math.atan2(here[1], here[0])
        turn = math.remainder(turn, 2 * math.pi)
        out = math.hypot(there[0], there[1]) - math.hypot(here[0], here[1])
        return turn, out / self.robot.length, (there[2] - here[2]) / self.robot.length

    def follow(self, poses: Iterable[pin.SE3 | np.ndarray]) -> Posture:
        """Posture with the tool at the last pose or place (3,) m, from the reference, or near it."""
        posture = Posture(self.robot.reference, 0.0)
        for pose in poses:
            posture = inverse_kinematics(self.robot, posture.q, {self.tool: pose})
        return posture

    def towards(self, turn: float, out: float, up: float, *, turned: bool = True) -> Posture:
        """Posture with the tool at that `pose`, or place alone, followed in steps, or as near as possible."""
        parts = np.linspace(0.0, 1.0, STEPS + 1)[1:]
        poses = [self.pose(part * turn, part * out, part * up) for part in parts]
        return self.follow(poses if turned else [pose.translation for pose in poses])

    def posture(self, turn: float, out: float, up: float) -> np.ndarray:
        """The posture (nq,) of `towards`. Raises InputError if the arm does not reach it."""
        return self.reached(self.towards(turn, out, up), self.pose(turn, out, up))

    def reached(self, posture: Posture, pose: pin.SE3) -> np.ndarray:
        """The posture (nq,), if it brings the tool to ``pose``. Raises InputError."""
        if posture.error > REACHED:
            x, y, z = pose.translation
            raise InputError(
                f"'{self.robot.name}' cannot bring '{self.tool}' to ({x:.3f}, {y:.3f}, {z:.3f}) m",
                self.allowed(f"poses within its reach ({self.robot.length:.2f} m) and joint ranges"),
            )
        return posture.q

    def is_clear(self, q: np.ndarray) -> bool:
        """Whether links that must not touch are apart, and above level ground, at ``q`` (nq,)."""
        scene = robot_shapes(self.robot).scene(self.robot.model, FlatGround())
        return bool(scene.distances_at(q).min(initial=0.0) >= 0)

    def allowed(self, usual: str) -> str:
        """What is allowed where the tool's pose is not reached: with few joints, hardly any pose."""
        joints = self.robot.nv
        if joints >= POSE_ROWS:
            return f"allowed: {usual}"
        return (
            f"a pose has six rows, three of place and three of turn, and '{self.robot.name}' {joints} joints;"
            f" allowed: arms with six joints; for the place alone arm-reach with {ORIENTATION}={FREE}"
        )

    def arrival(self, pose: pin.SE3, q: np.ndarray, *, turned: bool = True) -> tuple[Term, Term]:
        """The tool ends at ``pose``, or at its place alone, and the joints at rest, near ``q`` (nq,)."""
        turn = pose.rotation if turned else None
        there = FramePose(frame=self.tool, position=pose.translation, rotation=turn)
        return there, TerminalRest(q=q)


def load(name: str | Robot) -> Arm:
    """Return the arm of that name; joints that do not move its tool are locked at the reference.

    Raises InputError if it is not an arm, or has joints that cannot move.
    """
    robot = robots.load(name)
    tool = robots.tool_frame(name, robot)
    model = robot.model
    moving = {model.names[j] for j in model.supports[model.frames[model.getFrameId(tool)].parentJoint]}
    moving |= {mimic.mimics for mimic in robot.mimics if mimic.joint in moving}
    moving |= {mimic.joint for mimic in robot.mimics if mimic.mimics in moving}
    idle = [joint for joint in list(model.names)[1:] if joint not in moving]
    arm = Arm(robot=robot.with_locked(idle) if idle else robot, tool=tool)
    require_moving(arm.robot)
    return arm


def least_duration(robot: Robot, postures: Sequence[np.ndarray], *, weight: bool = True) -> float:
    """Duration of a guess from rest to rest through ``postures`` (nq,), s, by limits of rates and torques.

    Torques are those that the arm's weight leaves (``weight``: or all), and each joint moves its own inertia
    alone: an estimate for a start of the search, not a bound.
    """
    model, data = robot.model, robot.model.createData()
    steps = [pin.difference(model, before, after) for before, after in pairwise(postures)]
    travel = np.abs(steps).sum(axis=0)
    by_rate = PEAK_RATE * travel / robot.velocity_limit
    if robot.torque_limit is None:
        if np.isinf(robot.velocity_limit).all():  # accelerate by one natural unit
            return float(np.sqrt(PEAK_ACCELERATION * travel.max()) * Units(robot).time)
        return float(by_rate.max())
    held, rows = [pin.computeGeneralizedGravity(model, data, q) for q in postures], robot.actuated_rows
    # If the motors cannot hold a posture, the problem is infeasible for any guess.
    left = robot.torque_limit - weight * np.abs(held).max(axis=0)[rows]
    spare = np.maximum(left, LEAST_SPARE * robot.torque_limit)
    inertia = np.diag(pin.crba(model, data, postures[0]))
    by_torque = np.sqrt(PEAK_ACCELERATION * (travel * inertia)[rows] / spare)
    return float(max(by_rate.max(), by_torque.max()))


def strength(arm: Arm, postures: Sequence[np.ndarray], direction: np.ndarray) -> float:
    """Force (N) at the tool along ``direction`` (3,) that joints resist beside gravity in ``postures``."""
    robot, data = arm.robot, arm.robot.model.createData()
    if robot.torque_limit is None:
        return robot.weight
    frame, least = robot.model.getFrameId(arm.tool), np.inf
    for q in postures:
        jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        left = robot.torque_limit - np.abs(pin.computeGeneralizedGravity(robot.model, data, q))
        lever = np.maximum(np.abs(direction @ jacobian), LEAST_LEVER * robot.length)
        least = min(least, float((left / lever).min()))
    return max(least, 0.0)


def torque_limits(robot: Robot) -> Term:
    """Torque limits, or those of the drives if the robot has any."""
    return TorqueLimits() if robot.drives is None else DriveLimits()


def between(
    name: str,
    robot: Robot,
    ends: tuple[np.ndarray, np.ndarray],
    duration: float,
    *,
    phase: str,
    bounds: common.Range | None = None,
    guess: Motion | None = None,
    **settings: Any,
) -> Problem:
    """A motion of one phase in ``duration`` s between two postures (nq,); see `common.problem`.

    bounds: of a free duration, s. guess: default straight from one posture to the other.
    """
    straight = PosturePath(model=robot.model, postures=ends, durations=(duration,))
    return common.problem(
        name,
        robot,
        Schedule((Phase(name=phase, duration=duration, duration_bounds=bounds),)),
        guess or straight,
        **{"initial_q": ends[0], "end": ends[1]} | settings,
    )


def part(name: str, default: float, meaning: str, within: common.Range = (-1.0, 1.0)) -> Parameter:
    """A length as a fraction of the arm's reach."""
    return common.number(name, default, "", f"{meaning}, over the reach", within)
