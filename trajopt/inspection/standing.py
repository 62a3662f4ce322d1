"""A robot's reference posture at rest: forces at its feet, torques at its joints, balance.

With g(q) = RNEA(q, 0, 0) minus joint forces such as springs, and the rows J of the feet, static balance is
g(q) = S^T tau + J^T f. Of all f that push (f_z >= 0) and balance the unactuated rows, the one of least norm
(in units of the weight and of weight times length) is taken; then tau = S (g(q) - J^T f).
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.dynamics.model_quantities import contact_jacobian
from trajopt.robot.actuators.joint_force import joint_force
from trajopt.robot.contact import Contact
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.legs import HAND_HEIGHT
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terrain.bodies import outline

# Weight of the balance equations relative to the norm of the forces: residuals are too small for a report.
BALANCE_WEIGHT = 1e4
# Base rows with residuals below this fraction of the weight (and weight times length) are in balance.
BALANCED = 1e-3


@dataclass(frozen=True, kw_only=True)
class StandingPosture:
    """The reference posture at rest.

    Args:
        feet: names of the contacts that stand.
        load: vertical forces (n,), one for each vertical row of the feet, N.
        effort: torques of the actuated rows, N m or N.
        unbalanced: largest residual of the unactuated rows, relative to weight and weight times length.
        centre: centre of mass over the ground (2,), world, m.
        margin: its distance inside the polygon of the feet, m, negative outside; None without a polygon.
    """

    feet: tuple[str, ...]
    load: np.ndarray
    effort: np.ndarray
    unbalanced: float
    centre: np.ndarray
    margin: float | None

    @property
    def balanced(self) -> bool:
        """Whether feet on the ground can hold the posture."""
        return self.unbalanced < BALANCED


def standing_feet(robot: Robot) -> tuple[Contact, ...]:
    """Contacts at the bottom of the reference posture; hands and knees are higher and do not count."""
    if robot.base == "fixed" or not robot.contacts:
        return ()
    poses = contact_poses(robot, robot.reference)
    lowest = min(pose.translation[2] for pose in poses.values())
    within = HAND_HEIGHT * robot.length
    return tuple(c for c in robot.contacts if poses[c.name].translation[2] - lowest < within)


def standing_posture(robot: Robot) -> StandingPosture:
    """Return forces, torques and balance of the reference posture at rest, on level ground under the feet."""
    feet = standing_feet(robot)
    zero = np.zeros(robot.nv)
    weight_force = pin.rnea(robot.model, robot.model.createData(), robot.reference, zero, zero)
    weight_force = weight_force - joint_force(robot.model, robot.joint_forces, robot.reference, zero)
    rows = [(contact.frame, contact.rows) for contact in feet]
    jacobian = contact_jacobian(robot.model, robot.reference, rows)
    free = robot.unactuated_rows
    scales = Units(robot).generalized_force[free]
    pushes, pushing = _pushes(robot, feet)
    carried = robot.weight * jacobian[:, free].T @ pushes / scales[:, None]
    wrench = robot.weight * pushes @ _least_forces(weight_force[free] / scales, carried, pushing)
    left = weight_force - jacobian.T @ wrench
    vertical = np.array([axis == 2 for contact in feet for axis in contact.rows], dtype=bool)
    centre = pin.centerOfMass(robot.model, robot.model.createData(), robot.reference)[:2]
    return StandingPosture(
        feet=tuple(contact.name for contact in feet),
        load=wrench[vertical],
        effort=left[robot.actuated_rows],
        unbalanced=float(np.abs(left[free] / scales).max(initial=0.0)),
        centre=centre,
        margin=inside(support_points(robot, feet), centre),
    )


def _pushes(robot: Robot, feet: tuple[Contact, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Wrench rows (n, k) of unit forces along rows of points or at corners of soles; which (k,) push up."""
    from scipy.linalg import block_diag  # takes a while to load

    poses = contact_poses(robot, robot.reference)
    blocks, pushing = [np.zeros((0, 0))], np.zeros(0, dtype=bool)
    for contact in feet:
        axes = list(contact.rows)
        block, up = np.eye(len(axes)), np.array(axes) == 2
        if contact.kind == "surface":
            arms = contact.corners @ poses[contact.name].rotation[:, :2].T
            block = np.hstack([np.vstack([np.eye(3), pin.skew(arm)])[axes] for arm in arms])
            up = np.tile([False, False, True], len(arms))
        blocks.append(block)
        pushing = np.concatenate([pushing, up])
    return block_diag(*blocks), pushing


def _least_forces(wanted: np.ndarray, carried: np.ndarray, pushing: np.ndarray) -> np.ndarray:
    """Least forces f, in weights, with ``carried`` f = ``wanted``; none that is ``pushing`` pulls."""
    count = carried.shape[1]
    if not count:
        return np.zeros(0)
    system = np.vstack([BALANCE_WEIGHT * carried, np.eye(count)])
    target = np.concatenate([BALANCE_WEIGHT * wanted, np.zeros(count)])
    from scipy.optimize import lsq_linear  # takes a while to load

    result = lsq_linear(system, target, (np.where(pushing, 0.0, -np.inf), np.inf), method="bvls")
    return np.asarray(result.x)


def support_points(robot: Robot, feet: tuple[Contact, ...]) -> np.ndarray:
    """Points (k, 2) on which feet stand, world, m: origins of points, and the four corners of soles."""
    poses = contact_poses(robot, robot.reference)
    points = [poses[c.name].translation + c.corners @ poses[c.name].rotation[:, :2].T for c in feet]
    return np.vstack([np.zeros((0, 3)), *points])[:, :2]


def inside(points: np.ndarray, place: np.ndarray) -> float | None:
    """Distance of ``place`` (2,) from the boundary of the hull of ``points`` (k, 2), m; negative outside.

    Outside, it is the largest distance beyond the line through a side. None without an area.
    """
    corners = points[outline(points)]
    if len(corners) < 3:
        return None
    along = np.roll(corners, -1, axis=0) - corners
    inward = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    return float(np.sum(inward * (place - corners), axis=1).min())
