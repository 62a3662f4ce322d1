"""Minimal coordinates: a floating robot on one point contact as a fixed-base robot.

"Look at these contact configurations as different fixed-base robots": while a foot stands, the robot is a
tree rooted at that foot. Its coordinates are the ankle (the orientation of the foot's link), the joints up to
the base, and the other limbs. The contact needs neither rows nor forces, and the ankle has no motor.

    mode = stance_mode(robot, "foot")       mode.robot        the fixed-base robot of the stance
    mode.lift(q, v, a, foothold)            stance    -> floating (q, v, a)
    mode.drop(q, v, a)                      floating  -> stance (q, v, a) and foothold
    mode.reaction(q, v, a)                  ground reaction force, from Newton's law of the whole robot

All three are `casadi.Function` of SX; ``lifted``, ``dropped`` and ``ground_reaction`` are the numeric forms.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt.arguments import checked
from trajopt.dynamics import rigid_body
from trajopt.dynamics.base_joint import position_limits
from trajopt.dynamics.rerooting import joint_motion, path_to_base, reroot
from trajopt.errors import InputError
from trajopt.kinds import ArrayShape
from trajopt.robot.building import joint_entries
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.robot import Robot
from trajopt.robot.stance.stance_maps import drop_map, lift_map, symbols

# Largest sine of the angle between axes that count as parallel: rounding in description files.
PARALLEL = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class StanceMode:
    """A floating or planar robot on one point contact, in minimal coordinates; made by `stance_mode`.

    The contact is embedded in the coordinates instead of constrained by rows. A ``foothold`` (3,) is its
    position in the world, m. The model is rooted at ``anchor``; another foothold displaces the floating robot
    and changes nothing else (a planar robot is not displaced out of its plane).

    Args:
        floating: the whole robot.
        contact: name of the contact it stands on.
        robot: the fixed-base robot of the stance, with the other contacts; its first joint is the ankle.
        anchor: position of the ankle in the world (3,), m.
    """

    floating: Robot
    contact: str
    robot: Robot
    anchor: np.ndarray

    @property
    def embedded(self) -> Contact:
        """The contact that these coordinates hold in place."""
        return self.floating.contact(self.contact)

    @cached_property
    def lift(self) -> ca.Function:
        """``(q, v, a, foothold) -> (q, v, a)`` of the floating robot, smooth everywhere."""
        return lift_map(self.robot.model, self.floating, self.anchor)

    @cached_property
    def drop(self) -> ca.Function:
        """``(q, v, a) -> (q, v, a, foothold)`` of the stance: the inverse of lift for a contact at rest.

        The contact point's own velocity and acceleration cannot be expressed in stance coordinates and are
        lost. The ankle angle of a planar robot jumps by a turn where the base's pitch passes half a turn;
        write the rows of a transition with ``lift``, which is smooth.
        """
        return drop_map(self.robot.model, self.floating, self.embedded.frame)

    @cached_property
    def reaction(self) -> ca.Function:
        """``(q, v, a) -> f`` (3,) N of all contacts on the robot, world axes: ``f = sum_i m_i (a_i - g)``."""
        model = self.robot.model
        q, v, a = symbols(model)
        _, rate = rigid_body.centroidal_momentum_rate(model)(q, v, a)
        force = rate[:3] - self.robot.mass * ca.DM(model.gravity.linear)
        return ca.Function("reaction", [q, v, a], [force], ["q", "v", "a"], ["f"])

    @cached_property
    def torque_rows(self) -> np.ndarray:
        """Indices (nu,) of the stance robot's torques among those of the floating robot."""
        _, rows = joint_entries(self.floating.model, list(self.robot.model.names)[2:])
        actuated = self.floating.actuated_rows
        return np.searchsorted(actuated, rows[np.isin(rows, actuated)])

    def lifted(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        a: ArrayLike | None = None,
        foothold: ArrayLike | None = None,
    ) -> list[np.ndarray]:
        """Numeric `lift` of one state or of rows (n, ...) of states: q, v and a of the floating robot.

        ``v`` and ``a`` default to zero, ``foothold`` to the anchor.
        """
        at = self.anchor if foothold is None else np.asarray(foothold)
        return _evaluated(self.lift, self.robot.nv, (q, v, a), at)

    def dropped(
        self, q: ArrayLike, v: ArrayLike | None = None, a: ArrayLike | None = None
    ) -> list[np.ndarray]:
        """Numeric `drop` of one state or of rows (n, ...) of states: q, v, a of the stance and foothold.

        ``v`` and ``a`` default to zero.
        """
        return _evaluated(self.drop, self.floating.nv, (q, v, a))

    def ground_reaction(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> np.ndarray:
        """Numeric `reaction` (3,) N of one state, or (n, 3) of rows of states."""
        return _evaluated(self.reaction, self.robot.nv, (q, v, a))[0]

    def loss(self, q: np.ndarray, v: np.ndarray) -> float:
        """Largest entry (m, rad; m/s, rad/s) of the part of a floating robot's state that `drop` loses."""
        back_q, back_v, _ = self.lifted(*self.dropped(q, v)[:3])
        apart = pin.difference(self.floating.model, q, back_q)
        return float(max(np.abs(apart).max(), np.abs(back_v - v).max()))


def _evaluated(
    function: ca.Function, nv: int, state: tuple[ArrayLike | None, ...], *constants: np.ndarray
) -> list[np.ndarray]:
    """Outputs of a function of (q, v, a) and constants for one state, or for rows of states."""
    q = np.asarray(state[0], dtype=float)
    zero = np.zeros((*q.shape[:-1], nv))
    arrays = [zero if part is None else np.asarray(part, dtype=float) for part in state]
    outputs = function.call([ca.DM(array.T) for array in (*arrays, *constants)])
    return [np.array(output).T.reshape(*q.shape[:-1], -1) for output in outputs]


@checked
def stance_mode(
    robot: Robot, contact: str, *, anchor: Annotated[ArrayLike, ArrayShape((3,))] | None = None
) -> StanceMode:
    """Return the minimal coordinates of ``robot`` while it stands on one point contact.

    Args:
        robot: a robot with a floating or planar base.
        contact: name of the contact.
        anchor: position of the contact in the world (3,), m; default that in the reference posture.

    Raises:
        InputError: for a base other than "freeflyer" or "planar", a sole, a contact that is not on a limb of
            the base, or a planar robot whose joints from base to contact leave the plane.
        UnsupportedJointError: for a joint on the way with more than one degree of freedom.
    """
    if robot.base not in ("freeflyer", "planar"):
        raise InputError(f"robot '{robot.name}' has base={robot.base!r}", "'freeflyer' or 'planar'")
    chosen = robot.contact(contact)
    if chosen.kind != "point":
        raise InputError(f"contact '{contact}' is a {chosen.kind}", "a point contact")
    if robot.base == "planar":
        _require_plane(robot, chosen)
    here = contact_positions(robot, robot.reference)[contact]
    given = here if anchor is None else anchor
    place = np.asarray(given, dtype=float)
    if robot.base == "planar":  # the contact stays at its own distance from the plane
        normal = robot.model.jointPlacements[1].rotation[:, 2]
        place = place + normal * float(normal @ (here - place))
    place.setflags(write=False)
    return StanceMode(
        floating=robot, contact=contact, robot=_stance_robot(robot, chosen, place), anchor=place
    )


def _require_plane(robot: Robot, contact: Contact) -> None:
    """Raise `InputError` if a joint from base to contact leaves the plane, in which the foot must turn."""
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, robot.reference)
    normal = model.jointPlacements[1].rotation[:, 2]
    for joint in path_to_base(model, int(model.frames[model.getFrameId(contact.frame)].parentJoint))[:-1]:
        motion = data.oMi[joint].rotation @ joint_motion(model.joints[joint]).angular
        slide = data.oMi[joint].rotation @ joint_motion(model.joints[joint]).linear
        if np.linalg.norm(np.cross(motion, normal)) > PARALLEL or abs(slide @ normal) > PARALLEL:
            raise InputError(
                f"joint '{model.names[joint]}' leaves the plane of robot '{robot.name}'",
                "joints in the plane between base and contact; lock it or take base='freeflyer'",
            )


def _stance_robot(robot: Robot, contact: Contact, anchor: np.ndarray) -> Robot:
    joint = pin.JointModelRZ() if robot.base == "planar" else pin.JointModelSpherical()
    axes = robot.model.jointPlacements[1].rotation if robot.base == "planar" else np.eye(3)
    passive = f"ankle_{contact.name}"
    model = reroot(robot.model, contact.frame, joint, passive, pin.SE3(axes, anchor))
    names = list(model.names)[2:]
    rows_q, rows_v = joint_entries(robot.model, names)
    free_q, free_v = model.nq - len(rows_q), model.nv - len(rows_v)
    lower, upper = position_limits(model)
    lower[free_q:], upper[free_q:] = robot.position_lower[rows_q], robot.position_upper[rows_q]
    standing = replace(
        robot,
        name=f"{robot.name} on {contact.name}",
        model=model,
        base="fixed",
        passive=(passive, *(name for name in names if name in robot.passive)),
        contacts=tuple(other for other in robot.contacts if other.name != contact.name),
        reference=np.concatenate([pin.neutral(model)[:free_q], robot.reference[rows_q]]),
        velocity_limit=np.concatenate([np.full(free_v, np.inf), robot.velocity_limit[rows_v]]),
        position_lower=lower,
        position_upper=upper,
        given_length=robot.length,
        **robot.actuators_of(rows_v),
    )
    mode = StanceMode(floating=robot, contact=contact.name, robot=standing, anchor=anchor)
    return replace(standing, reference=mode.dropped(robot.reference)[0])
