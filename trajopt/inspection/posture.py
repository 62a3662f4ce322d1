"""A posture for a robot read from a description: legs bent, feet under the centre of mass; an arm bent."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from trajopt.collision.description import robot_shapes
from trajopt.inspection.limbs import tool_joint
from trajopt.robot.actuators.mimic import followed
from trajopt.robot.building import put_on_ground, reference_posture
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses, contact_targets, inverse_kinematics
from trajopt.robot.robot import Robot
from trajopt.terrain.flat import FlatGround

# Length of a bent leg over that of a straight one: the first that the limits allow.
BENDS = (0.87, 0.92, 0.97)
# |cosine| of the angle between axes of one leg that bend it in one plane.
PARALLEL = 0.9
# A leg counts as bent if it is this near to its length, over that of a straight one.
BEND_ERROR = 0.03
# A foot is in front of or behind the others if it is farther from their middle than this, over the length.
AHEAD = 0.05
# Inverse kinematics has succeeded if feet are level up to this fraction of the height, or rad.
FOOT_ERROR = 1e-6
# Iterations: moving the legs shifts the centre of mass, by less each time.
CENTRINGS = 6
# An arm is bent if the least singular value of its tool's Jacobian over the largest is below the first.
# Joints turn in steps, rad, within the inner part of their limits, links keep a distance, m, and torques at
# rest are at most a fraction of their limits; what is missed counts by weights.
SINGULAR, STEPS, INNER, APART = 0.05, (0.5, -0.5, 1.0, -1.0, 1.5, -1.5), 0.9, 0.01
HELD, OVERLOAD, CLEAR, LEAST_TORQUE = 0.8, 10.0, 10.0, 1e-3
# Passes over all joints, and the least improvement.
BETTER = 1e-6
SWEEPS = 3


def standing(robot: Robot) -> Robot:
    """The robot with bent legs and its feet below the centre of mass, as far as limits allow.

    A robot with a keyframe, or on another base than a free-flyer, is returned as it is.
    """
    if robot.base != "freeflyer" or not robot.contacts or _has_keyframe(robot):
        return robot
    for part in (*BENDS, None):
        q = _stood(robot, part)
        if q is not None:
            return replace(robot, reference=q)
    return robot


def _has_keyframe(robot: Robot) -> bool:
    usual = reference_posture(robot.model, robot.base, robot.contacts, None)
    joints = slice(7 if robot.base == "freeflyer" else 0, None)  # an MJCF file has its own height
    return not np.allclose(robot.reference[joints], usual[joints])


def _stood(robot: Robot, part: float | None) -> np.ndarray | None:
    """Posture with legs bent to a ``part`` of their length, or as they are; None if feet do not get there."""
    model, data, q = robot.model, robot.model.createData(), robot.reference.copy()
    poses = contact_poses(robot, q)
    middle = np.mean([pose.translation for pose in poses.values()], axis=0)
    for contact in robot.contacts if part else ():
        ahead = float(poses[contact.name].translation[0] - middle[0])
        forward = -np.sign(ahead) if abs(ahead) > AHEAD * robot.length else 1.0
        q = _bent_leg(robot, q, contact, part or 1.0, forward)
    q = put_on_ground(model, robot.base, robot.contacts, q)
    for _ in range(CENTRINGS):
        shift = pin.centerOfMass(model, data, q) - middle
        placed = {
            contact.name: pin.SE3(
                np.eye(3), np.append((poses[contact.name].translation + shift)[:2], contact.radius)
            )
            for contact in robot.contacts
        }
        q = inverse_kinematics(robot, q, contact_targets(robot, placed)).q
    reached = contact_poses(robot, q)
    off = [reached[name].translation[2] - pose.translation[2] for name, pose in placed.items()]
    tilts = [reached[c.name].rotation[2, :2] for c in robot.contacts if c.kind == "surface"]
    worst = max(np.abs(off).max() / robot.length, np.abs(tilts).max() if tilts else 0.0)
    return q if worst < FOOT_ERROR else None


def _bent_leg(robot: Robot, q: np.ndarray, contact: Contact, part: float, forward: float) -> np.ndarray:
    """``q`` with one leg bent to a ``part`` of its length at its knee, which moves ``forward`` (1 or -1).

    The knee is the joint farthest from both ends; joints parallel to it keep the foot where it is, and level.
    Of the two ways to bend it, one may be outside the limits.
    """
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId(contact.frame)
    foot, last = data.oMf[frame].translation, int(model.frames[frame].parentJoint)
    chain = [j for j in model.supports[last] if j > 1 and model.joints[j].nv == 1]
    chain = [j for j in chain if not (contact.rolling and j == last)]
    if len(chain) < 2:
        return q
    places = {j: data.oMi[j].translation for j in chain}
    axes = {j: data.J[3:, model.joints[j].idx_v] for j in chain}
    knee = max(chain[1:], key=lambda j: min(np.linalg.norm(places[j] - p) for p in (places[chain[0]], foot)))
    parallel = [j for j in chain if abs(axes[j] @ axes[knee]) > PARALLEL]
    hip, ankle = parallel[0], parallel[-1]
    end = foot if ankle == knee else places[ankle]
    plane = np.eye(3) - np.outer(axes[knee], axes[knee])  # across the knee's axis
    upper, lower, now = (
        float(np.linalg.norm(plane @ way))
        for way in (places[knee] - places[hip], end - places[knee], end - places[hip])
    )
    if hip == knee or not lower:
        return q
    wanted = part * (upper + lower)
    if now <= wanted:
        return q
    angles = [
        np.arccos(np.clip((upper**2 + lower**2 - d**2) / (2 * upper * lower), -1, 1)) for d in (now, wanted)
    ]
    found = []
    for change in (angles[0] - angles[1], angles[1] - angles[0]):
        bent, share = q.copy(), lower / (upper + lower)
        for joint, part_of in ((knee, 1.0), (hip, -share), *([(ankle, share - 1)] if ankle != knee else [])):
            at = model.joints[joint].idx_q
            turned = q[at] + np.sign(axes[joint] @ axes[knee]) * part_of * change
            bent[at] = np.clip(turned, robot.position_lower[at], robot.position_upper[at])
        pin.framesForwardKinematics(model, data, bent)
        tip = data.oMf[frame].translation if ankle == knee else data.oMi[ankle].translation
        place, moved = data.oMi[hip].translation, data.oMi[knee].translation
        error = abs(np.linalg.norm(plane @ (tip - place)) - wanted) / (upper + lower)
        ahead = forward * (moved - (place + tip) / 2)[0]
        found.append((error > BEND_ERROR, -ahead, error, bent))
    best = min(found, key=lambda each: each[:2])
    return best[3] if best[2] <= BEND_ERROR else q


def bent_arm(robot: Robot) -> Robot:
    """The arm away from its limits, and bent in steps so that it moves its tool in all directions.

    Joints whose limits leave out zero begin in the middle. Links are apart and above the ground, and torques
    at rest within their limits, if they can. A robot with a keyframe is returned as it is.
    """
    model, joint = robot.model, tool_joint(robot.model)
    if not joint or _has_keyframe(robot):
        return robot
    search, q = _ArmSearch(robot, joint), _off_limits(robot)
    values = search.values(q)
    over = {j for j in range(1, model.njoints) if search.overload(q)[model.joints[j].idx_v]}
    if values[-1] >= SINGULAR * values[0] and not over and search.clear(q) == 1:
        return replace(robot, reference=q)
    loaded = {j for j in range(1, model.njoints) if over & set(model.supports[j])}
    moved = [j for j in range(1, model.njoints) if any(j in model.supports[k] for k in (joint, *loaded))]
    leaders = {each.joint: model.getJointId(each.mimics) for each in robot.mimics}
    moved = list(dict.fromkeys(leaders.get(model.names[j], j) for j in moved))
    best, start = search.score(q), q
    for one in (model.joints[j] for j in SWEEPS * moved if model.joints[j].nq == 1):
        lower, upper = _inner(robot, one.idx_q)
        for step in STEPS:
            turned = q.copy()
            turned[one.idx_q] = start[one.idx_q] + step
            turned = followed(model, robot.mimics, turned)
            if lower <= turned[one.idx_q] <= upper and (found := search.score(turned)) > best + BETTER:
                best, q = found, turned
    return replace(robot, reference=q)


class _ArmSearch:
    """Figures of an arm's postures q (nq,)."""

    def __init__(self, robot: Robot, joint: int) -> None:
        self.robot, self.model, self.data = robot, robot.model, robot.model.createData()
        self.scene = robot_shapes(robot).scene(robot.model, FlatGround())
        self.tool = max(i for i, frame in enumerate(robot.model.frames) if frame.parentJoint == joint)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Singular values of the tool's Jacobian, of its position alone for less than six joints."""
        jacobian = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)
        jacobian = np.reshape(jacobian, (6, self.robot.nv), order="F") @ self.robot.actuation.independent
        moving = jacobian[:, np.abs(jacobian).any(axis=0)]
        count = moving.shape[1]
        moving = np.vstack([moving[:3] / self.robot.length, moving[3 : 6 if count >= 6 else 3]])
        return np.asarray(np.linalg.svd(moving, compute_uv=False))

    def clear(self, q: np.ndarray) -> float:
        """Least distance of links that must not touch, over the one that they should keep, at most 1."""
        distances = self.scene.distances_at(q) if self.scene.pairs else np.zeros(0)
        return float(distances.min(initial=APART) / APART)

    def overload(self, q: np.ndarray) -> np.ndarray:
        """Torques at rest (nv,) over their limits, less the fraction that they may have."""
        over, rows, limit = np.zeros(self.robot.nv), self.robot.actuated_rows, self.robot.torque_limit
        if limit is not None:
            held = np.abs(pin.computeGeneralizedGravity(self.model, self.data, q))[rows]
            over[rows] = np.maximum(held / np.maximum(limit[: len(rows)], LEAST_TORQUE) - HELD, 0.0)
        return over

    def score(self, q: np.ndarray) -> float:
        """How well the tool moves, how clear links are and how little motors are overloaded."""
        moves = float(np.log(self.values(q) + SINGULAR).sum())
        return moves + CLEAR * self.clear(q) - OVERLOAD * float(self.overload(q).sum())


def _inner(robot: Robot, index: int) -> tuple[float, float]:
    """The inner part of a joint's limits."""
    lower, upper = float(robot.position_lower[index]), float(robot.position_upper[index])
    margin = (1 - INNER) / 2 * (upper - lower)
    return (lower + margin, upper - margin) if np.isfinite(margin) else (lower, upper)


def _off_limits(robot: Robot) -> np.ndarray:
    """The reference (nq,) with joints at or near their limits in the middle between them."""
    q = robot.reference.copy()
    for joint in list(robot.model.joints)[1:]:
        if joint.nq == 1:
            lower, upper = _inner(robot, joint.idx_q)
            if not lower <= q[joint.idx_q] <= upper:
                q[joint.idx_q] = (
                    (lower + upper) / 2
                    if np.isfinite(lower + upper)
                    else np.clip(q[joint.idx_q], lower, upper)
                )
    return q
