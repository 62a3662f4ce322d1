"""Passive joint forces: springs, damping and dry friction; and springs in series with a motor.

    f(q, v) = -k (q - q_0) - d v - c tanh(v / v_s)            M a + h = S^T tau + J^T w + f

with q and v of a joint of one degree of freedom (Featherstone, Rigid Body Dynamics Algorithms, 2008, sec.
3.6; Andersson, Soederberg, Bjoerklund, Tribology International 40, 2007, for friction that is smooth in v).
The torques tau are those of the actuators alone; a spring in parallel carries its share of the load.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.arguments import NonNegative, Positive, checked
from trajopt.dynamics.rerooting import Body, copy_bodies, joint_motion
from trajopt.errors import InputError, UnsupportedJointError, require_fields
from trajopt.robot.actuators.drive import COULOMB_SPEED

# Suffix of the name of a series spring's joint.
SPRING = "_spring"


@checked
@dataclass(frozen=True, kw_only=True)
class JointForce:
    """A spring, damping and dry friction at a joint of one degree of freedom.

    Args:
        joint: name of the joint.
        stiffness: k, N m/rad or N/m; only for joints with one coordinate.
        rest: q_0, position at which the spring is unloaded, rad or m.
        damping: d, N m s/rad or N s/m.
        dry_friction: c, N m or N.
        dry_speed: v_s, speed at which dry friction reaches 76 % of c, rad/s or m/s.
    """

    joint: str
    stiffness: NonNegative = 0.0
    rest: float = 0.0
    damping: NonNegative = 0.0
    dry_friction: NonNegative = 0.0
    dry_speed: Positive = COULOMB_SPEED

    @classmethod
    def from_meta(cls, meta: Any) -> "JointForce":
        """Joint force from its description in a solution file. Raises `InputError` for a malformed one."""
        require_fields(cls, meta, "a joint's force")
        return cls(**meta)

    def to_meta(self) -> dict[str, Any]:
        """Fields for JSON."""
        return asdict(self)

    def entries(self, model: pin.Model) -> tuple[int, int]:
        """Index of the joint in q, and in v. Raises `InputError`."""
        if not model.existJointName(self.joint):
            raise InputError(
                f"joint '{self.joint}' of a force is unknown", "one of " + ", ".join(list(model.names)[1:])
            )
        joint = model.joints[model.getJointId(self.joint)]
        if joint.nv != 1 or (joint.nq != 1 and self.stiffness > 0):
            allowed = "joints of one degree of freedom, springs of one coordinate"
            raise UnsupportedJointError(self.joint, joint.shortname(), allowed)
        return int(joint.idx_q), int(joint.idx_v)

    def symbol(self, position: ca.SX, rate: ca.SX | None) -> ca.SX:
        """Symbolic force at a position and a rate; with ``rate=None``, that of the spring alone."""
        force = -self.stiffness * (position - self.rest)
        if rate is not None:
            force -= self.damping * rate + self.dry_friction * ca.tanh(rate / self.dry_speed)
        return force


def joint_force(model: pin.Model, forces: Sequence[JointForce], q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Passive forces (..., nv) at configurations (..., nq) and velocities (..., nv)."""
    total = np.zeros(np.shape(v))
    for force in forces:
        place, row = force.entries(model)
        rate = v[..., row]
        total[..., row] -= force.stiffness * (q[..., place] - force.rest) + force.damping * rate
        total[..., row] -= force.dry_friction * np.tanh(rate / force.dry_speed)
    return total


def described_forces(
    model: pin.Model, springs: Mapping[str, tuple[float, float]] = MappingProxyType({})
) -> tuple[JointForce, ...]:
    """Damping, dry friction and ``springs`` (stiffness, rest by joint) of joints of one degree of freedom."""
    forces = []
    for joint in list(model.joints)[1:]:
        if joint.nv == 1:
            name = model.names[joint.id]
            stiffness, rest = springs.get(name, (0.0, 0.0))
            damping, dry = model.damping[joint.idx_v], model.upperDryFrictionLimit[joint.idx_v]
            if damping > 0 or dry > 0 or stiffness > 0:
                given = {"damping": float(damping), "dry_friction": float(dry)}
                forces.append(JointForce(joint=name, stiffness=stiffness, rest=rest, **given))
    return tuple(forces)


def with_spring_joints(model: pin.Model, joints: Sequence[str]) -> pin.Model:
    """Return a model with a spring joint behind each of ``joints``, with the same axis; it carries the link.

    Its position is the deflection of the spring: position of the link minus position of the gear. Only the
    reflected inertia of the rotor, the armature, stays on the gear's side. Raises `InputError`.
    """
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    bodies = {0: Body(0, pin.SE3.Identity())}
    for index in range(1, model.njoints):
        parent, joint, name = bodies[int(model.parents[index])], model.joints[index], model.names[index]
        added = new.addJoint(parent.joint, joint, parent.placement * model.jointPlacements[index], name)
        if name in joints:
            if joint.nv != 1:
                raise UnsupportedJointError(name, joint.shortname(), "joints of one degree of freedom")
            if not model.armature[joint.idx_v] > 0:
                raise InputError(
                    f"joint '{name}' has no armature, so that the gear of a series spring has no inertia",
                    "allowed: joints with an armature, or a Drive with a rotor_inertia",
                )
            axis = joint_motion(joint)
            turns = bool(np.any(axis.angular))
            kind = pin.JointModelRevoluteUnaligned if turns else pin.JointModelPrismaticUnaligned
            spring = kind(np.array(axis.angular if turns else axis.linear))
            added = new.addJoint(added, spring, pin.SE3.Identity(), name + SPRING)
        bodies[index] = Body(added, pin.SE3.Identity())
    copy_bodies(model, new, {index: body for index, body in bodies.items() if index})
    return new
