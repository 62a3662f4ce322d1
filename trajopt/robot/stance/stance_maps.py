"""Maps between the coordinates of a stance and those of the floating robot, as functions of SX.

The stance model is the floating model re-rooted (`rerooting`). Its first joint is the ankle; the others are
joints of the floating model with the same names and coordinates. The maps copy those coordinates, and compute
the base from the ankle, or the ankle from the base, by kinematics.
"""

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.manifold import CONTINUOUS_JOINTS
from trajopt.dynamics.rerooting import BASE_FRAME, joint_motion, joint_slices, path_to_base
from trajopt.dynamics.rotations import quaternion_product
from trajopt.robot.robot import Robot

NAMES = ("q", "v", "a")


def symbols(model: pin.Model) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Symbols of q (nq,), v and a (nv,)."""
    return ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv), ca.SX.sym("a", model.nv)


def lift_map(stance: pin.Model, floating: Robot, anchor: np.ndarray) -> ca.Function:
    """``(q, v, a, foothold) -> (q, v, a)``: stance to floating, with the contact at ``foothold`` (3,) m."""
    model = floating.model
    q, v, a = symbols(stance)
    foothold = ca.SX.sym("foothold", 3)
    base = _planar_base if floating.base == "planar" else _free_base
    parts = base(stance, model.jointPlacements[1], (q, v, a), foothold - ca.DM(anchor))
    lifted = ca.SX.zeros(model.nq), ca.SX.zeros(model.nv), ca.SX.zeros(model.nv)
    for target, part in zip(lifted, parts, strict=True):
        target[: part.numel()] = part
    for (from_q, from_v), (to_q, to_v) in _shared_joints(stance, model):
        lifted[0][to_q], lifted[1][to_v], lifted[2][to_v] = q[from_q], v[from_v], a[from_v]
    return ca.Function(
        "lift", [q, v, a, foothold], list(lifted), [*NAMES, "foothold"], [f"{name}_out" for name in NAMES]
    )


def _shared_joints(
    stance: pin.Model, floating: pin.Model
) -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Slices (q, v) in the stance model and in the floating one, of every joint but the ankle."""
    names = list(stance.names)[2:]
    return [(joint_slices(stance, name), joint_slices(floating, name)) for name in names]


def _base_motion(stance: pin.Model, state: tuple[ca.SX, ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Twist (6,) of the base and its rate as Pinocchio's spatial acceleration, in the base's axes."""
    velocity = rigid_body.frame_velocity(stance, BASE_FRAME, "local")(*state[:2])
    classical = rigid_body.frame_acceleration(stance, BASE_FRAME, "local")(*state)
    transport = ca.cross(velocity[3:], velocity[:3])
    return velocity, ca.vertcat(classical[:3] - transport, classical[3:])


def _planar_base(
    stance: pin.Model, root: pin.SE3, state: tuple[ca.SX, ca.SX, ca.SX], moved: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    rotation, position = rigid_body.frame_placement(stance, BASE_FRAME)(state[0])
    velocity, acceleration = _base_motion(stance, state)
    place = ca.mtimes(ca.DM(root.rotation.T), position + moved - ca.DM(root.translation))
    turn = ca.mtimes(ca.DM(root.rotation.T), rotation)
    in_plane = [0, 1, 5]
    return ca.vertcat(place[:2], turn[0, 0], turn[1, 0]), velocity[in_plane], acceleration[in_plane]


def _free_base(
    stance: pin.Model, root: pin.SE3, state: tuple[ca.SX, ca.SX, ca.SX], moved: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    base = stance.frames[stance.getFrameId(BASE_FRAME)]
    _, position = rigid_body.frame_placement(stance, BASE_FRAME)(state[0])
    place = ca.mtimes(ca.DM(root.rotation.T), position + moved - ca.DM(root.translation))
    orientation = _turned(_orientation(stance, int(base.parentJoint), state[0]), base.placement.rotation)
    quaternion = quaternion_product(_constant(root.rotation.T), orientation)
    return ca.vertcat(place, quaternion), *_base_motion(stance, state)


def drop_map(stance: pin.Model, floating: Robot, frame: str) -> ca.Function:
    """``(q, v, a) -> (q, v, a, foothold)``: floating to stance on the contact ``frame``."""
    model = floating.model
    q, v, a = symbols(model)
    _, foothold = rigid_body.frame_placement(model, frame)(q)
    # The frame's axes relative to the ankle's, the same in every posture.
    held = stance.frames[stance.getFrameId(frame)].placement.rotation
    rate = ca.mtimes(ca.DM(held), rigid_body.frame_velocity(model, frame, "local")(q, v)[3:])
    change = ca.mtimes(ca.DM(held), rigid_body.frame_acceleration(model, frame, "local")(q, v, a)[3:])
    foot = model.frames[model.getFrameId(frame)]
    if floating.base == "planar":
        ankle = ca.atan2(q[3], q[2]) + _turned_in_plane(model, int(foot.parentJoint), q)
        rate, change = rate[2], change[2]
    else:
        to_ankle = foot.placement.rotation @ held.T
        ankle = _turned(_orientation(model, int(foot.parentJoint), q), to_ankle)
    dropped = ca.SX.zeros(stance.nq), ca.SX.zeros(stance.nv), ca.SX.zeros(stance.nv)
    for target, part in zip(dropped, (ankle, rate, change), strict=True):
        target[: part.numel()] = part
    for (to_q, to_v), (from_q, from_v) in _shared_joints(stance, model):
        dropped[0][to_q], dropped[1][to_v], dropped[2][to_v] = q[from_q], v[from_v], a[from_v]
    outputs = [*(f"{name}_out" for name in NAMES), "foothold"]
    return ca.Function("drop", [q, v, a], [*dropped, foothold], list(NAMES), outputs)


def _turned_in_plane(model: pin.Model, joint: int, q: ca.SX) -> ca.SX:
    """Angle (rad, nose up) that the joints from the base down to ``joint`` add to the base's pitch."""
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    normal, angle = model.jointPlacements[1].rotation[:, 2], ca.SX(0)
    for index in path_to_base(model, joint)[:-1]:
        axis = joint_motion(model.joints[index]).angular
        sign = float(np.round(normal @ data.oMi[index].rotation @ axis))
        if sign:
            angle += sign * _joint_angle(model, index, q)
    return angle


def _joint_angle(model: pin.Model, joint: int, q: ca.SX) -> ca.SX:
    entries = q[joint_slices(model, model.names[joint])[0]]
    kind = model.joints[joint].shortname().removeprefix("JointModel")
    return ca.atan2(entries[1], entries[0]) if kind in CONTINUOUS_JOINTS else entries[0]


def _orientation(model: pin.Model, joint: int, q: ca.SX) -> ca.SX:
    """Quaternion of the joint's frame in the world: a product along the chain, with a continuous sign."""
    chain = [joint]
    while model.parents[chain[-1]] > 0:
        chain.append(int(model.parents[chain[-1]]))
    orientation = ca.SX([0, 0, 0, 1])
    for index in reversed(chain):
        orientation = _turned(orientation, model.jointPlacements[index].rotation)
        orientation = quaternion_product(orientation, _joint_quaternion(model, index, q))
    return orientation


def _joint_quaternion(model: pin.Model, joint: int, q: ca.SX) -> ca.SX:
    if model.joints[joint].nv > 1:  # free-flyer or spherical
        return q[joint_slices(model, model.names[joint])[0]][-4:]
    axis = joint_motion(model.joints[joint]).angular
    half = _joint_angle(model, joint, q) / 2
    return ca.vertcat(ca.sin(half) * ca.DM(axis), ca.cos(half)) if axis.any() else ca.SX([0, 0, 0, 1])


def _constant(rotation: np.ndarray) -> ca.SX:
    return ca.SX(pin.Quaternion(rotation).coeffs().tolist())


def _turned(orientation: ca.SX, rotation: np.ndarray) -> ca.SX:
    return quaternion_product(orientation, _constant(rotation))
