"""Numeric kinematics: frame poses, and inverse kinematics by damped Gauss-Newton."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from trajopt.arguments import PositiveCount, checked
from trajopt.dynamics.model_content import frame_content
from trajopt.errors import InputError
from trajopt.robot.robot import Robot

# A pose, or a position (3,) in m, for each frame by name.
Targets = Mapping[str, pin.SE3 | np.ndarray]

# Tolerance of inverse kinematics: a smaller error does not matter to a guess.
TOLERANCE = 1e-10
# Rotation (9,) given for targets that are positions; it is not used.
NO_TURN = tuple(np.eye(3).ravel().tolist())


@checked
def frame_pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    """Pose of a frame in the world, m.

    Args:
        robot: the robot.
        q: configuration (nq,).
        frame: name of the frame.

    Raises:
        InputError: for an unknown frame; it lists close names.
    """
    _require_size(robot, q)
    frame_content(robot.model, frame)  # checks the name: for an unknown one Pinocchio's index is past the end
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)].copy()


@checked
def contact_poses(robot: Robot, q: np.ndarray) -> dict[str, pin.SE3]:
    """Pose of every contact's frame at ``q`` (nq,), world, m, by the contact's name."""
    _require_size(robot, q)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {c.name: data.oMf[robot.model.getFrameId(c.frame)].copy() for c in robot.contacts}


@checked
def contact_positions(robot: Robot, q: np.ndarray) -> dict[str, np.ndarray]:
    """Position of every contact at ``q`` (nq,): its frame's origin (3,), world, m, by the contact's name."""
    return {name: pose.translation for name, pose in contact_poses(robot, q).items()}


@checked
def contact_targets(robot: Robot, poses: Mapping[str, pin.SE3]) -> dict[str, pin.SE3 | np.ndarray]:
    """Targets that bring contacts to ``poses`` (world, m, by name): poses of soles, positions of points."""
    return {
        contact.frame: poses[contact.name] if contact.kind == "surface" else poses[contact.name].translation
        for contact in robot.contacts
        if contact.name in poses
    }


@dataclass(frozen=True)
class Posture:
    """Result of inverse kinematics: ``q`` (nq,) and the remaining ``error`` (norm, m and rad)."""

    q: np.ndarray
    error: float


@checked
def inverse_kinematics(robot: Robot, q: np.ndarray, targets: Targets, *, move_base: bool = False) -> Posture:
    """Posture near ``q`` (nq,) that brings frames to their targets, within position limits.

    Targets out of reach are approached in the least-squares sense.

    Args:
        robot: the robot.
        q: configuration (nq,) from which the search starts.
        targets: pose (SE3, 6 rows) or position (3,) in the world, m, by the frame's name.
        move_base: whether the base may move, too.

    Raises:
        InputError: for an unknown frame, no target, or other shapes.
    """
    _require_size(robot, q)
    _require_targets(robot, targets)
    movable = robot.actuation.leading if move_base else robot.actuated_rows
    return _searched(robot, q, targets, movable, TOLERANCE)


def _searched(
    robot: Robot, q: np.ndarray, targets: Targets, movable: np.ndarray, tolerance: float
) -> Posture:
    """The posture found by moving rows ``movable`` of v; ``q`` itself if its error is below tolerance."""
    poses = [
        [*each.rotation.ravel(), *each.translation] if isinstance(each, pin.SE3) else [*NO_TURN, *each]
        for each in targets.values()
    ]
    return Posture(
        *robot.posture_search.search(
            np.ascontiguousarray(q, dtype=float),
            [int(robot.model.getFrameId(name)) for name in targets],
            np.array(poses, dtype=float),
            _sizes(targets),
            movable.tolist(),
            tolerance,
        )
    )


def _sizes(targets: Targets) -> list[int]:
    """Number of rows of each target: 6 for a pose, 3 for a position."""
    return [6 if isinstance(target, pin.SE3) else 3 for target in targets.values()]


def _require_size(robot: Robot, q: np.ndarray) -> None:
    if q.shape != (robot.nq,):
        raise InputError(f"q has shape {q.shape}", f"allowed: ({robot.nq},), one for each coordinate")


def _require_targets(robot: Robot, targets: Targets) -> None:
    if not targets:
        raise InputError("targets are empty", "allowed: a pose or a position for each frame by name")
    for name, target in targets.items():
        if not robot.model.existFrame(name):
            frame_content(robot.model, name)  # which says so
        if not isinstance(target, pin.SE3) and np.shape(target) != (3,):
            raise InputError(f"target of '{name}' has shape {np.shape(target)}", "allowed: (3,), or an SE3")


# Number of starts of the search for branches: each of the eight branches of a six-joint arm attracts a few
# per cent of them, so missing one is improbable (counted in docs/modelling/irb1600.md).
STARTS = 256
# Postures of one branch, each refined to ``TOLERANCE``, differ by rounding divided by the least singular
# value.
SAME_BRANCH = 1e-4
# Distance between representatives of the continuum of a redundant arm, rad or m.
SEPARATION = 1.0


@checked
def inverse_kinematics_branches(
    robot: Robot,
    targets: Targets,
    *,
    near: np.ndarray | None = None,
    starts: PositiveCount = STARTS,
    separation: float | None = None,
    turns: bool = False,
) -> tuple[Posture, ...]:
    """All postures that bring frames to their targets within position limits, nearest to ``near`` first.

    Each start of the search is refined to 1e-10 by `inverse_kinematics`, and then verified. Each branch of an
    arm (shoulder, elbow, wrist) is returned once, in the turn nearest to ``near``. An arm with more joints
    than rows has a continuum of postures, of which these are representatives. The result is empty if no
    posture within the limits reaches the targets.

    Finding all branches is not guaranteed; more ``starts`` may find what fewer miss. At a singularity, where
    branches meet, convergence is slow and ``separation`` decides what counts as different.

    Args:
        robot: the robot; its base stays where it is in ``near``.
        targets: as in `inverse_kinematics`.
        near: configuration (nq,), default the reference.
        starts: number of postures to search from, of a deterministic Halton sequence over the joints.
        separation: distance between representatives of a continuum, norm over the joints, rad and m; default
            1.0. For other arms, the distance above which two branches count as different.
        turns: whether to also return each branch at every whole turn of its joints within their limits.

    Raises:
        InputError: for ``starts`` below one, and as `inverse_kinematics`.
    """
    near = robot.reference if near is None else np.asarray(near, dtype=float)
    _require_size(robot, near)
    _require_targets(robot, targets)
    redundant = robot.nu > sum(_sizes(targets))
    if separation is None:
        separation = SEPARATION if redundant else SAME_BRANCH
    turning = _turning_joints(robot)
    searched = robot
    if not redundant:  # limits only choose among the turns of an isolated posture
        lower, upper = robot.position_lower.copy(), robot.position_upper.copy()
        lower[turning], upper[turning] = -np.inf, np.inf
        searched = replace(robot, position_lower=lower, position_upper=upper)
    branches: list[np.ndarray] = []
    for start in _starts(robot, near, starts):
        posture = inverse_kinematics(searched, start, targets)
        if posture.error > TOLERANCE:
            continue
        q = _in_nearest_turn(robot, posture.q, near, turning)
        if q is not None and all(_distance(robot, q, other, turning) > separation for other in branches):
            branches.append(q)
    if turns:
        branches = [turned for q in branches for turned in _all_turns(robot, q, turning)]
    branches.sort(key=lambda q: float(np.linalg.norm(pin.difference(robot.model, near, q))))
    return tuple(_searched(robot, q, targets, robot.actuated_rows, math.inf) for q in branches)


def _turning_joints(robot: Robot) -> list[int]:
    """Index in q of every actuated revolute joint of one coordinate, which repeats after a whole turn."""
    return [
        int(joint.idx_q)
        for joint in list(robot.model.joints)[1:]
        if joint.nq == joint.nv == 1
        and joint.idx_v in robot.actuated_rows
        and joint.shortname().removeprefix("JointModel").startswith("R")
    ]


def _starts(robot: Robot, near: np.ndarray, count: int) -> Iterator[np.ndarray]:
    """``near``, then postures of a Halton sequence: limited joints over their range, others over a turn."""
    from scipy.stats import qmc  # takes half a second to load

    yield near
    free = robot.actuated_rows
    lower, upper = np.full(robot.nv, -math.pi), np.full(robot.nv, math.pi)
    for joint in list(robot.model.joints)[1:]:
        if joint.nq == joint.nv:
            of_v, of_q = (slice(i, i + joint.nv) for i in (joint.idx_v, joint.idx_q))
            below, above = robot.position_lower[of_q] - near[of_q], robot.position_upper[of_q] - near[of_q]
            limited = np.isfinite(below) & np.isfinite(above)
            lower[of_v], upper[of_v] = np.where(limited, below, -math.pi), np.where(limited, above, math.pi)
    for point in qmc.Halton(len(free), scramble=False).random(count - 1):
        step = np.zeros(robot.nv)
        step[free] = lower[free] + point * (upper[free] - lower[free])
        yield pin.integrate(robot.model, near, step)


def _in_nearest_turn(robot: Robot, q: np.ndarray, near: np.ndarray, turning: list[int]) -> np.ndarray | None:
    """The posture with each revolute joint in the turn nearest to ``near`` within limits, or None."""
    best = q.copy()
    for index in turning:
        choices = _within(robot, q, index)
        if len(choices) == 0:
            return None
        best[index] = choices[np.argmin(np.abs(choices - near[index]))]
    inside = (best >= robot.position_lower - TOLERANCE) & (best <= robot.position_upper + TOLERANCE)
    return best if inside.all() else None


def _within(robot: Robot, q: np.ndarray, index: int) -> np.ndarray:
    """Values of one revolute joint within its limits that are whole turns from its value in ``q``.

    A missing limit counts as half a turn from the reference.
    """
    lower, upper = robot.position_lower[index], robot.position_upper[index]
    lower = lower if np.isfinite(lower) else robot.reference[index] - math.pi
    upper = upper if np.isfinite(upper) else robot.reference[index] + math.pi
    first = math.ceil((lower - TOLERANCE - q[index]) / (2 * math.pi))
    last = math.floor((upper + TOLERANCE - q[index]) / (2 * math.pi))
    return np.asarray(q[index] + 2 * math.pi * np.arange(first, last + 1))


def _all_turns(robot: Robot, q: np.ndarray, turning: list[int]) -> Iterator[np.ndarray]:
    for values in itertools.product(*[_within(robot, q, index) for index in turning]):
        turned = q.copy()
        turned[turning] = values
        yield turned


def _distance(robot: Robot, q: np.ndarray, other: np.ndarray, turning: list[int]) -> float:
    """Norm of the difference in the tangent space, without whole turns of revolute joints."""
    difference = pin.difference(robot.model, other, q)
    rows = [int(joint.idx_v) for joint in list(robot.model.joints)[1:] if joint.idx_q in turning]
    difference[rows] = np.remainder(difference[rows] + math.pi, 2 * math.pi) - math.pi
    return float(np.linalg.norm(difference))
