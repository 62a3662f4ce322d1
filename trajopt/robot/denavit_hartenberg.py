"""Arms from Denavit-Hartenberg parameters, as textbooks and data sheets give them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin

from trajopt.arguments import Array3, Array33, NonNegative, UnboundedPositive, checked
from trajopt.errors import InputError
from trajopt.kinds import Range
from trajopt.robot.robot import Robot

Bound = Annotated[float, Range(infinite=True)]


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class DhJoint:
    """A joint and the link behind it; limits of a prismatic joint are in m, m/s and N.

    Args:
        a: length of the link, m.
        alpha: twist of the link, rad.
        d: offset along the joint's axis, m; for a prismatic joint it is added to the coordinate.
        theta: rotation about the joint's axis, rad; for a revolute joint it is added to the coordinate.
        kind: kind of the joint.
        mass: mass of the link, kg.
        centre: centre of mass (3,), m, in the link's frame, behind the joint's transform; None: its origin.
        inertia: inertia about the centre of mass (3, 3), kg m^2, in the frame's axes; None: a point mass.
        lower: lower position limit, rad.
        upper: upper position limit, rad.
        velocity: velocity limit, rad/s.
        torque: torque limit, N m.
        armature: inertia of the rotor on the joint side, kg m^2.
    """

    a: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    kind: Literal["revolute", "prismatic"] = "revolute"
    mass: NonNegative = 0.0
    centre: Array3 | None = None
    inertia: Array33 | None = None
    lower: Bound = -math.inf
    upper: Bound = math.inf
    velocity: UnboundedPositive = math.inf
    torque: UnboundedPositive = math.inf
    armature: NonNegative = 0.0


@checked
def robot_from_dh(
    joints: Sequence[DhJoint], *, convention: Literal["standard", "modified"] = "standard", **options: Any
) -> Robot:
    """Return the arm with these parameters: joints are "joint1", ..., frames of links "link1", ....

        standard:  T_i = Rot_z(theta_i) Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i)
        modified:  T_i = Rot_x(alpha_i) Trans_x(a_i) Rot_z(theta_i) Trans_z(d_i)

    T_i is the pose of link i in the link before it, T_1 in the world. In the modified convention (J. J.
    Craig, Introduction to Robotics, 2005, eq. 3.6) a_i and alpha_i are a_(i-1) and alpha_(i-1) of his tables.

    Args:
        joints: joints from the base to the tip.
        convention: convention of the parameters.
        options: further arguments of `Robot.from_model`.

    Raises:
        InputError: for no joints, and as `Robot`.
    """
    if not joints:
        raise InputError("robot_from_dh has no joints", "allowed: one or more")
    model, parent, before = pin.Model(), 0, pin.SE3.Identity()
    for number, joint in enumerate(joints, start=1):
        turned = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, joint.theta), np.array([0.0, 0.0, joint.d]))
        along = pin.SE3(pin.rpy.rpyToMatrix(joint.alpha, 0.0, 0.0), np.array([joint.a, 0.0, 0.0]))
        place, link = (before, turned * along) if convention == "standard" else (before * along, turned)
        kind = pin.JointModelRZ() if joint.kind == "revolute" else pin.JointModelPZ()
        limits = (np.array([each]) for each in (joint.torque, joint.velocity, joint.lower, joint.upper))
        parent = model.addJoint(parent, kind, place, f"joint{number}", *limits)
        model.addJointFrame(parent)
        centre = np.zeros(3) if joint.centre is None else joint.centre
        inertia = np.zeros((3, 3)) if joint.inertia is None else joint.inertia
        if not np.allclose(inertia, inertia.T) or np.linalg.eigvalsh(inertia)[0] < 0:
            what = f"inertia of joint {number} of robot_from_dh is not that of a rigid body"
            raise InputError(what, "allowed: symmetric, eigenvalues >= 0")
        model.appendBodyToJoint(parent, pin.Inertia(joint.mass, centre, inertia), link)
        model.addBodyFrame(f"link{number}", parent, link, -1)
        before = link
    model.armature = np.array([joint.armature for joint in joints])
    return Robot.from_model(model, **{"name": "arm", "base": "fixed", **options})
