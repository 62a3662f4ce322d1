"""The recursive Newton-Euler method link by link: joint forces and the constraint forces in the bearings.

The forward pass from the root, in the axes of each link ``i`` (parent ``p``, origin at joint ``i``), is

    omega_i = R^T (omega_p + omega_J)
    alpha_i = R^T (alpha_p + omega_p x omega_J + alpha_J)
    a_i     = R^T (a_p + alpha_p x r + omega_p x (omega_p x r) + 2 omega_p x r' + r'')
    a_c,i   = a_i + alpha_i x c_i + omega_i x (omega_i x c_i)

with the joint's own motion ``R(q), r(q), omega_J, alpha_J, r', r''`` in the parent's axes. The backward pass
is the balance of each link about its centre of mass,

    f_i = sum R f_child + m_i a_c,i - m_i g_i - f_ext
    n_i = sum R n_child - f_i x c_i + sum (R f_child) x (c_i - r_child) + I_i alpha_i + omega_i x I_i omega_i

(Spong, Hutchinson, Vidyasagar, "Robot Modeling and Control", 2006, section 7.6; there for revolute joints
with ``r' = r'' = 0``). It uses classical accelerations and forces instead of spatial algebra; `pin.rnea`
computes the same independently.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from trajopt.dynamics import rigid_body
from trajopt.dynamics.model_content import once_per_content
from trajopt.dynamics.model_quantities import require_shapes
from trajopt.errors import InputError

_LINK = "link"


@dataclass(frozen=True, kw_only=True)
class JointForces:
    """Forces at every joint; row k is of joint k + 1 of the model, named ``joints[k]``.

    tau: (nv,) generalised force of the actuators, N m or N, including what accelerates rotors (armature).
    force, moment: (n, 3) of the parent link on the link through the joint, N and N m, at the joint's origin,
        in the link's axes.
    constraint_force, constraint_moment: (n, 3) the part of these that the bearing carries: the component
        outside the joint's motion subspace, which does no work.
    """

    joints: tuple[str, ...]
    tau: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    constraint_force: np.ndarray
    constraint_moment: np.ndarray


def joint_forces(
    model: pin.Model,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    *,
    frames: Sequence[str] = (),
    wrenches: np.ndarray | None = None,
) -> JointForces:
    """Return actuator, joint and constraint forces of a motion.

    Args:
        model: Model of any robot.
        q: Configuration (nq,).
        v: Velocity (nv,).
        a: Acceleration (nv,).
        frames: Frames at whose origins wrenches act on the robot.
        wrenches: (n, 6: force N, moment N m), world axes.

    Raises:
        InputError: If a shape or name is wrong.
        UnsupportedJointError: If a kind of joint is unknown.
    """
    require_shapes(model, q=q, v=v, a=a)
    outer = outer_wrenches(frames, wrenches)
    function = recursive_newton_euler(model, frames, [6] * len(frames))
    tau, *columns = (value.full() for value in function.call([ca.DM(x) for x in (q, v, a, outer.ravel())]))
    force, moment, constraint_force, constraint_moment = (value.T for value in columns)
    return JointForces(
        joints=tuple(model.names)[1:],
        tau=tau.ravel(),
        force=force,
        moment=moment,
        constraint_force=constraint_force,
        constraint_moment=constraint_moment,
    )


def outer_wrenches(frames: Sequence[str], wrenches: np.ndarray | None) -> np.ndarray:
    """Return the wrenches (n, 6) on n frames, by default zero; raises `InputError` for another shape."""
    outer = np.zeros((len(frames), 6)) if wrenches is None else np.asarray(wrenches, dtype=float)
    if outer.shape != (len(frames), 6):
        raise InputError(f"wrenches have shape {outer.shape}", f"shape {(len(frames), 6)}")
    return outer


def recursive_newton_euler(
    model: pin.Model, frames: Sequence[str] = (), wrench_kinds: Sequence[int] = ()
) -> ca.Function:
    """Return ``(q, v, a, w) -> (tau, force, moment, constraint_force, constraint_moment)`` on SX.

    ``w`` stacks the wrenches on ``frames`` as in `rigid_body.fused`: 0, 3 or 6 entries each, world axes.
    Outputs are as in `JointForces`, one column per joint. Built once per model content. Raises `InputError`
    for an unknown frame or wrench size, `UnsupportedJointError` for an unsupported joint.
    """
    return _function(model, rigid_body.loaded_frames(model, frames, wrench_kinds))


@dataclass(frozen=True, kw_only=True)
class _Link:
    """Motion of a link in its own axes, except ``position``, its origin in the parent's axes."""

    rotation: ca.SX  # to the parent's axes
    position: ca.SX
    world_rotation: ca.SX
    omega: ca.SX
    alpha: ca.SX
    acceleration: ca.SX  # of the origin, classical
    subspace: ca.SX  # (6, nv of the joint): linear, angular


@once_per_content
def _function(model: pin.Model, outer: tuple) -> ca.Function:
    q, v, a = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv), ca.SX.sym("a", model.nv)
    w = ca.SX.sym("w", sum(content[-1] for content in outer))
    links = _forward(model, q, v, a)
    force, moment = _backward(model, links, _outer_wrenches(model, links, outer, w))
    tau, bearing_force, bearing_moment = [], [], []
    for index in range(1, model.njoints):
        subspace, wrench = links[index].subspace, ca.vertcat(force[index], moment[index])
        along = ca.mtimes(subspace.T, wrench)
        carried = wrench - ca.mtimes(subspace, ca.solve(ca.mtimes(subspace.T, subspace), along))
        tau.append(along)
        bearing_force.append(carried[:3])
        bearing_moment.append(carried[3:])
    outputs = [ca.vertcat(*tau) + ca.DM(model.armature) * a]
    outputs += [ca.horzcat(*columns) for columns in (force[1:], moment[1:], bearing_force, bearing_moment)]
    names = ["tau", "force", "moment", "constraint_force", "constraint_moment"]
    return ca.Function("newton_euler", [q, v, a, w], outputs, ["q", "v", "a", "w"], names)


def _forward(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> list[_Link]:
    """Return the motion of every link from the root outwards; the root is at rest."""
    rest, axes = ca.SX.zeros(3), ca.SX.eye(3)
    root = _Link(
        rotation=axes, position=rest, world_rotation=axes, omega=rest, alpha=rest, acceleration=rest,
        subspace=ca.SX(6, 0),
    )  # fmt: skip
    links = [root]
    for index in range(1, model.njoints):
        links.append(_moved(model, index, links[model.parents[index]], q, v, a))
    return links


def _moved(model: pin.Model, index: int, parent: _Link, q: ca.SX, v: ca.SX, a: ca.SX) -> _Link:
    joint, single = model.joints[index], _single_joint(model, index)
    q_joint = q[joint.idx_q : joint.idx_q + joint.nq]
    rows = slice(joint.idx_v, joint.idx_v + joint.nv)
    motion = rigid_body.fused(single, [_LINK], [0]).call([q_joint, v[rows], a[rows], ca.SX(0, 1)])
    R, r, velocity, acceleration = ca.reshape(motion[1], 3, 3), *motion[2:]
    omega, alpha, omega_J = parent.omega, parent.alpha, velocity[3:]
    turned = ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r))
    carried = 2 * ca.cross(omega, velocity[:3]) + acceleration[:3]
    return _Link(
        rotation=R,
        position=r,
        world_rotation=ca.mtimes(parent.world_rotation, R),
        omega=ca.mtimes(R.T, omega + omega_J),
        alpha=ca.mtimes(R.T, alpha + ca.cross(omega, omega_J) + acceleration[3:]),
        acceleration=ca.mtimes(R.T, parent.acceleration + turned + carried),
        subspace=rigid_body.frame_jacobian(single, _LINK, "local")(q_joint),
    )


def _single_joint(model: pin.Model, index: int) -> pin.Model:
    """Return a model of one joint, whose motion in world axes is the relative motion in the parent's axes."""
    single = pin.Model()
    joint = single.addJoint(0, model.joints[index], model.jointPlacements[index], model.names[index])
    single.addFrame(pin.Frame(_LINK, joint, 0, pin.SE3.Identity(), pin.OP_FRAME))
    return single


def _outer_wrenches(
    model: pin.Model, links: list[_Link], outer: tuple, w: ca.SX
) -> list[tuple[ca.SX, ca.SX]]:
    """Return force and moment on every link, at its origin in its axes, from wrenches ``w`` in world axes."""
    sums = [(ca.SX.zeros(3), ca.SX.zeros(3)) for _ in range(model.njoints)]
    start = 0
    for joint, _, place, size in outer:
        wrench = ca.vertcat(w[start : start + size], ca.SX.zeros(6 - size))
        start += size
        to_link = links[joint].world_rotation.T
        force, moment = ca.mtimes(to_link, wrench[:3]), ca.mtimes(to_link, wrench[3:])
        arm = ca.cross(ca.SX(ca.DM(place)), force)
        sums[joint] = (sums[joint][0] + force, sums[joint][1] + moment + arm)
    return sums


def _backward(
    model: pin.Model, links: list[_Link], outer: list[tuple[ca.SX, ca.SX]]
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Return force and moment through every joint, from each link's balance about its centre of mass."""
    gravity = ca.SX(ca.DM(model.gravity.linear))
    children: list[list[int]] = [[] for _ in range(model.njoints)]
    force, moment = [ca.SX.zeros(3)] * model.njoints, [ca.SX.zeros(3)] * model.njoints
    for index in range(model.njoints - 1, 0, -1):
        children[model.parents[index]].append(index)
        link, inertia = links[index], model.inertias[index]
        centre, tensor = ca.SX(ca.DM(inertia.lever)), ca.SX(ca.DM(inertia.inertia))
        spin = ca.cross(link.alpha, centre) + ca.cross(link.omega, ca.cross(link.omega, centre))
        weight = inertia.mass * ca.mtimes(link.world_rotation.T, gravity)
        f = inertia.mass * (link.acceleration + spin) - weight - outer[index][0]
        n = ca.mtimes(tensor, link.alpha) + ca.cross(link.omega, ca.mtimes(tensor, link.omega))
        n = n - outer[index][1] + ca.cross(centre, outer[index][0])
        for child in children[index]:
            child_force = ca.mtimes(links[child].rotation, force[child])
            f = f + child_force
            n = n + ca.mtimes(links[child].rotation, moment[child])
            n = n + ca.cross(child_force, centre - links[child].position)
        force[index], moment[index] = f, n - ca.cross(f, centre)
    return force, moment
