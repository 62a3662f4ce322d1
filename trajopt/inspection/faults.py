"""Common faults of robot descriptions, each found by a computation and reported in one line."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.collision.description import robot_shapes
from trajopt.dynamics.base_joint import BASE_JOINT
from trajopt.dynamics.model_quantities import contact_jacobian, joints_of_rows
from trajopt.errors import InputError
from trajopt.inspection.limbs import tool_joint
from trajopt.inspection.standing import StandingPosture
from trajopt.robot.building import reach
from trajopt.robot.joint_checks import joints_without_inertia
from trajopt.robot.kinematics import contact_poses
from trajopt.robot.legs import biped_legs, quadruped_legs
from trajopt.robot.mirror import find_mirror
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units

# A rigid body has I_1 + I_2 >= I_3; descriptions may violate this by this fraction of I_3, from rounding.
TRIANGLE_SLACK = 0.01
# A radius of gyration beyond this many extents of the robot indicates an inertia in other units.
LARGEST_GYRATION = 1.0
# A joint nearer to a limit than this fraction of its range cannot move both ways for long.
NEAR_LIMIT = 0.02
# A foot cannot move in some direction if the least singular value of its Jacobian is below this fraction of
# the largest: a knee bent by 3 degrees has 0.02.
SINGULAR = 0.02
# Fractions of the robot's length: feet on the same ground differ in height by less than the first, and their
# shapes reach less than the second below the points that touch.
UNEVENNESS, SHAPE_DEPTH = 0.02, 0.2
# If a foot's own shape is deeper in the ground than this, m, the contact's radius is not that of the foot.
FOOT_DEPTH = 1e-3
# Larger differences of left and right (rad, or fractions of mass and length) are not due to rounding.
ASYMMETRIC = 0.1
# Torques of mirrored legs are compared to this many decimals, N m, so that the first of them is named.
DIGITS = 6
# Number of names that are listed; the rest are counted.
LISTED_NAMES = 4

_Lines = Iterator[str]


def find_faults(robot: Robot, standing: StandingPosture) -> tuple[str, ...]:
    """One line for each fault, the worst first: bodies, limits, reference, shapes, feet, left and right."""
    legged = robot.base != "fixed"
    doubts = robot_shapes(robot).doubts(robot.model)
    faults = [*_bodies(robot), *_limits(robot), *_reference(robot, standing), *doubts]
    if legged:
        faults += [*_feet(robot, standing), *_legs(robot, standing), *_sides(robot)]
    else:
        faults += _tool(robot)
    return tuple(faults)


def listed(names: Sequence[str]) -> str:
    """Names separated by commas; if there are many, the first few and the number of the rest."""
    more = len(names) - LISTED_NAMES
    return ", ".join(names[:LISTED_NAMES]) + (f" and {more} more" if more > 0 else "")


def _bodies(robot: Robot) -> _Lines:
    model = robot.model
    extent = max(reach(model), robot.length)
    data = model.createData()
    pin.computeSubtreeMasses(model, data)
    light, points, unreal, large = [], [], [], []
    for joint in range(BASE_JOINT[robot.base] or 1, model.njoints):
        inertia, name = model.inertias[joint], model.names[joint]
        principal = np.linalg.eigvalsh(inertia.inertia)
        if data.mass[joint] == 0:
            light.append(name)
        elif inertia.mass and principal[2] <= 0:
            points.append(name)
        elif principal[0] + principal[1] < (1 - TRIANGLE_SLACK) * principal[2]:
            unreal.append(name)
        if inertia.mass and np.sqrt(principal[2] / inertia.mass) > LARGEST_GYRATION * extent:
            large.append(name)
    if light:
        yield f"no mass is moved by {listed(light)}: is <inertial> missing?"
    still = [name for name in joints_without_inertia(robot) if name not in light]
    if still:
        yield f"no inertia is moved by {listed(still)}: lock them, or give their links moments of inertia"
    if points:
        yield f"mass without moments of inertia is moved by {listed(points)}: a body is not a point"
    if unreal:
        yield f"inertias that no body has (I1 + I2 < I3) are moved by {listed(unreal)}"
    if large:
        yield f"inertias of bodies larger than the robot are moved by {listed(large)}: in kg m^2?"


def _limits(robot: Robot) -> _Lines:
    units, model, rows = Units(robot), robot.model, robot.actuated_rows
    effort = np.full(robot.nu, np.inf) if robot.torque_limit is None else robot.torque_limit
    moving = [joint for joint in list(model.joints)[1:] if joint.idx_v in rows]
    torque = {model.names[j.id]: effort[np.isin(rows, j.idx_v + np.arange(j.nv))] for j in moving}
    rates = {model.names[j.id]: robot.velocity_limit[j.idx_v : j.idx_v + j.nv] for j in moving}
    bounds = {
        model.names[j.id]: (robot.position_upper - robot.position_lower)[j.idx_q : j.idx_q + j.nq]
        for j in moving
    }
    for values, is_fault, what in (
        (torque, lambda x: x == 0, "torque limit 0, so that it can hold nothing:"),
        (torque, np.isinf, "no torque limit:"),
        (
            torque,
            lambda x: np.isfinite(x) & (x > units.unreachable_torque),
            f"torque limit beyond {units.unreachable_torque:.3g} N m, which limits nothing (a placeholder?):",
        ),
        (rates, lambda x: x == 0, "velocity limit 0, so that it cannot move:"),
        (rates, np.isinf, "no velocity limit:"),
        (bounds, lambda x: x == 0, "position limits that leave no range:"),
    ):
        yield from _named(values, is_fault, what)


def _named(values: dict[str, np.ndarray], is_fault: Callable[[np.ndarray], np.ndarray], what: str) -> _Lines:
    names = [name for name, value in values.items() if np.any(is_fault(value))]
    if names:
        yield f"{what} {'all joints' if len(names) == len(values) > 1 else listed(names)}"


def _reference(robot: Robot, standing: StandingPosture) -> _Lines:
    q, near = robot.reference, []
    for joint in list(robot.model.joints)[1:]:
        if joint.idx_v not in robot.actuated_rows or joint.nq != joint.nv:
            continue
        rows = slice(joint.idx_q, joint.idx_q + joint.nq)
        lower, upper = robot.position_lower[rows], robot.position_upper[rows]
        with np.errstate(invalid="ignore"):
            gap = np.minimum(q[rows] - lower, upper - q[rows]) / (upper - lower)
        if (gap < NEAR_LIMIT).any():
            near.append(robot.model.names[joint.id])
    if near:
        yield f"the reference posture is at a position limit of {listed(near)}"
    if robot.torque_limit is None or not standing.balanced:
        return
    over = np.flatnonzero(np.abs(standing.effort) > robot.torque_limit[: len(standing.effort)])
    if len(over):
        worst = max(over, key=lambda row: round(float(abs(standing.effort[row])), DIGITS))
        yield (
            f"the reference posture takes {abs(standing.effort[worst]):.3g} at joint"
            f" '{joints_of_rows(robot.model)[robot.actuated_rows[worst]]}', beyond its torque limit"
            f" {robot.torque_limit[worst]:.3g}"
        )


def _feet(robot: Robot, standing: StandingPosture) -> _Lines:
    if not robot.contacts:
        yield "no contacts: contacts=[...] of Robot.from_urdf names the frames of the feet"
        return
    poses = contact_poses(robot, robot.reference)
    heights = {name: pose.translation[2] - robot.contact(name).radius for name, pose in poses.items()}
    lowest = min(heights.values())
    uneven = [name for name in standing.feet if heights[name] - lowest > UNEVENNESS * robot.length]
    if uneven:
        highest = max(heights[name] - lowest for name in standing.feet)
        yield f"feet are not at one height in the reference posture: {listed(uneven)}, up to {highest:.3g} m"
    if not standing.balanced:
        out = "" if standing.margin is None or standing.margin > 0 else f", {-standing.margin:.3g} m outside"
        yield (
            "the reference posture falls over: the centre of mass, at "
            f"({standing.centre[0]:.3g}, {standing.centre[1]:.3g}) m, is not over the feet{out}"
        )
    for find, count in ((biped_legs, 2), (quadruped_legs, 4)):
        if len(standing.feet) == count:
            try:
                find(robot)
            except InputError as error:
                yield error.what
    yield from _deep_feet(robot, standing)


def _legs(robot: Robot, standing: StandingPosture) -> _Lines:
    stiff = []
    for name in standing.feet:
        contact = robot.contact(name)
        joint = robot.model.frames[robot.model.getFrameId(contact.frame)].parentJoint
        support = [robot.model.joints[k] for k in robot.model.supports[joint]]
        rows = [j.idx_v + i for j in support for i in range(j.nv) if j.idx_v in robot.actuated_rows]
        linear = [row for row in contact.rows if row < 3]
        jacobian = contact_jacobian(robot.model, robot.reference, [(contact.frame, linear)])[:, rows]
        values = np.linalg.svd(jacobian, compute_uv=False)
        if len(values) and values[-1] < SINGULAR * values[0]:
            stiff.append(name)
    if stiff:
        yield (
            f"in the reference posture the legs cannot move {listed(stiff)} in some direction:"
            " a straight knee, or a joint whose <axis> repeats another's"
        )


def _tool(robot: Robot) -> _Lines:
    """Report an arm of six or more joints that cannot move or turn its last frame in some direction."""
    if robot.nv < 6:
        return
    frame = [f.name for f in robot.model.frames if f.parentJoint == tool_joint(robot.model)][-1]
    jacobian = contact_jacobian(robot.model, robot.reference, [(frame, 6)])
    jacobian[:3] /= robot.length
    values = np.linalg.svd(jacobian, compute_uv=False)
    if values[-1] < SINGULAR * values[0]:
        yield f"the reference posture is singular: '{frame}' cannot move in some direction; bend the arm"


def _deep_feet(robot: Robot, standing: StandingPosture) -> _Lines:
    """Report contacts above the lowest point of their body: at an ankle or a knee, or at a ball's centre."""
    below = {name: depth for name, depth in depths_below(robot, standing).items() if depth > FOOT_DEPTH}
    far = [name for name, depth in below.items() if depth > SHAPE_DEPTH * robot.length]
    if far:
        worst = max(below[name] for name in far)
        yield f"shapes of feet reach {worst:.3g} m below the frames of {listed(far)}: are they the feet's?"
    deep = [name for name in below if name not in far and robot.contact(name).kind == "point"]
    if deep:
        deepest = max(deep, key=lambda name: below[name])
        radius = robot.contact(deepest).radius
        yield (
            f"feet reach {1e3 * below[deepest]:.1f} mm into the ground under {listed(deep)}, contacts"
            f" of radius {radius:g} m; Contact(radius={radius + below[deepest]:.3g})?"
        )


def depths_below(robot: Robot, standing: StandingPosture) -> dict[str, float]:
    """Depth of each foot's shapes below its point of contact, m, in the reference posture.

    Collision shapes are used, or drawn ones for bodies without them; feet without either are left out.
    """
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.reference)
    depths = {}
    for name in standing.feet:
        contact = robot.contact(name)
        frame = robot.model.frames[robot.model.getFrameId(contact.frame)]
        place = data.oMi[frame.parentJoint].act(frame.placement).translation[2]
        for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
            lowest = _lowest_of_body(robot, kind, data, int(frame.parentJoint))
            if np.isfinite(lowest):
                depths[name] = float(place - contact.radius - lowest)
                break
    return depths


def _lowest_of_body(robot: Robot, kind: pin.GeometryType, data: pin.Data, joint: int) -> float:
    """Height of the lowest point of a body's shapes, m; infinite if it has none."""
    try:
        geometry = shapes_of(robot, kind)
    except InputError:
        return np.inf
    shapes = [] if geometry is None else [g for g in geometry.geometryObjects if g.parentJoint == joint]
    heights = [_lowest(g.geometry, data.oMi[joint] * g.placement) for g in shapes]
    return min(heights, default=np.inf)


@lru_cache(maxsize=2)
def shapes_of(robot: Robot, kind: pin.GeometryType = pin.GeometryType.VISUAL) -> pin.GeometryModel | None:
    """Visual or collision shapes of a robot; None without a description. Raises `InputError`."""
    return None if robot.visual is None else robot.visual.geometry(robot.model, kind)


def _lowest(shape: object, place: pin.SE3) -> float:
    """Height of the lowest point of a shape, m; infinite for an unknown kind."""
    import coal

    up, height = place.rotation[2], place.translation[2]
    if isinstance(shape, coal.Sphere):
        return float(height - shape.radius)
    if isinstance(shape, coal.Box):
        return float(height - np.abs(up) @ shape.halfSide)
    if isinstance(shape, coal.Cylinder):
        return float(height - shape.halfLength * abs(up[2]) - shape.radius * np.hypot(up[0], up[1]))
    if isinstance(shape, coal.Capsule):
        return float(height - shape.halfLength * abs(up[2]) - shape.radius)
    if isinstance(shape, coal.BVHModelBase):
        return float(height + (shape.vertices() @ up).min(initial=np.inf))
    return float("inf")


def _sides(robot: Robot) -> _Lines:
    try:
        mirror = find_mirror(robot)
    except InputError as error:
        if robot.base == "freeflyer":
            yield error.what
        return
    if mirror.asymmetry > ASYMMETRIC:
        yield f"left and right differ by {mirror.asymmetry:.2g}: {mirror.worst}"
