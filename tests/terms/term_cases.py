"""Every public cost and constraint with the formula of its docstring, in NumPy."""

import math
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pinocchio as pin

from tests.support.problems import FOOT, hopper, one_joint_arm, planar_hopper
from tests.terms.term_points import Case, Point, RowsOf, Scale
from trajopt import terms
from trajopt.robot import Drive, Robot
from trajopt.schedule import Phase, middle_of, start_of
from trajopt.terms.context_symbols import Place
from trajopt.terms.friction import APEX, TIGHT, TIP
from trajopt.terrain import Bump, FlatGround, Incline, Patch, SmoothTerrain, Surface
from trajopt.terrain.crossing import Crossing

INF, MU = np.inf, 0.6
UP = np.array([0.0, 0.0, 1.0])
TILT = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
TURN = pin.exp3(np.array([0.3, -0.2, 0.4]))
PLACE = np.array([0.3, -0.1, 0.2])
TWIST = np.array([0.2, -0.1, 0.3, 0.4, -0.5, 0.6])
GOAL = np.concatenate([[0.2, 0.1, 0.4], pin.Quaternion(TURN).coeffs(), [0.3, -0.1]])
sole = partial(hopper, "surface")


@lru_cache
def driven() -> Robot:
    """The hopper with a motor that has all limits and friction, and one with none."""
    full = Drive(
        gear_ratio=-9.0, viscous_friction=0.1, coulomb_friction=0.3, torque_limit=1.5, stall_torque=1.0,
        no_load_speed=50.0,
    )  # fmt: skip
    return hopper().with_drives((full, Drive(gear_ratio=40.0)))


@lru_cache
def limited_arm() -> Robot:
    return replace(one_joint_arm(True), torque_limit=np.ones(1))


@lru_cache
def ball() -> Robot:
    """The hopper on a ball."""
    return replace(hopper(), contacts=(replace(hopper().contacts[0], radius=0.03),))


def plane(normal: np.ndarray, **options: Any) -> Any:
    return lambda scale: Surface(point=0.1 * scale.length * UP, normal=normal, friction=MU, **options)


def sliding(scale: Scale) -> Surface:
    return plane(TILT, slip_speed=0.2 * scale.length / scale.time)(scale)


def hills(scale: Scale) -> SmoothTerrain:
    bump = Bump(rise=0.1 * scale.length, radius=0.4 * scale.length, centre=(0.2 * scale.length, 0.0))
    return SmoothTerrain(shapes=(Incline(level=0.05 * scale.length, slope_x=0.2), bump), friction=MU)


def slope(scale: Scale) -> FlatGround:
    return FlatGround(height=0.1 * scale.length, friction=MU, normal=tuple(TILT))


def goal(scale: Scale) -> np.ndarray:
    return GOAL * [*[scale.length] * 3, *[1.0] * 5, scale.length]


def rates(scale: Scale) -> np.ndarray:
    """Pinocchio's velocity (8,) of the hopper."""
    linear = np.array([1.0, 1, 1, 0, 0, 0, 0, 1], dtype=bool)
    return 0.1 * np.arange(1, 9) * np.where(linear, scale.length, 1.0) / scale.time


def node(scale: Scale, index: int = 2, **options: Any) -> terms.NodePlace:
    """A node of a phase of 4 intervals, at its middle."""
    phase = Phase(name="phase", duration=1.0, **options)
    return terms.NodePlace(phase, index, (0.0, 0.25, 0.5, 0.75, 1.0), index == 4)


stands = partial(node, contacts=(FOOT,))


# Formulas


def posture(point: Point, term: Any) -> np.ndarray:
    return (point.xi[6:] - term.q[7:]) / point.units.position[6:]


def wrench(point: Point, term: Any) -> np.ndarray:
    rows = list(point.robot.contacts[0].rows)
    return point.wrench[rows] / point.units.wrench[rows]


def power(point: Point, term: Any) -> float:
    """Of the drive with a voltage line heat is tau_m^2 no_load_speed / stall_torque."""
    unit, r, s = point.units.torque / point.units.time, term.recovered, term.smoothing
    p = point.torque * point.v[6:] / unit
    drawn = (1 + r) / 2 * p + (1 - r) / 2 * (np.sqrt(p**2 + s**2) - s)
    motor = point.robot.drives[0]
    heat = (point.torque[0] / motor.gear_ratio) ** 2 * motor.no_load_speed / motor.stall_torque
    return float(term.weight * (drawn.sum() + heat / unit))


def motor_torque(point: Point, term: Any) -> np.ndarray:
    first, second = point.robot.drives
    largest = np.array([first.stall_torque, point.units.torque / second.gear_ratio])
    return point.torque / [first.gear_ratio, second.gear_ratio] / largest


def tracking(point: Point, term: Any) -> np.ndarray:
    aim, here = term.reference(0.0), point.q
    turn = pin.log3((pin.XYZQUATToSE3(aim[:7]).inverse() * pin.XYZQUATToSE3(here[:7])).rotation)
    angle, length = np.linalg.norm(turn), point.units.length
    chord = 2 * math.sin(angle / 2) * turn / angle
    return np.concatenate([(here[:3] - aim[:3]) / length, chord, (here[7:] - aim[7:]) / [1.0, length]])


def base(point: Point, term: Any) -> RowsOf:
    n = point.robot.n_unactuated
    return point.forces[:n], 0.0, 0.0, point.units.generalized_force[:n]


def still(point: Point, term: Any) -> RowsOf:
    """In the base's axes for a free-flyer, along the normal of a surface on which the contact slides."""
    contact, acceleration = point.robot.contacts[0], point.acceleration(FOOT)
    unit = point.units.contact_acceleration
    if getattr(point.surface, "slip_speed", None):
        return [point.surface.normal @ acceleration[:3]], 0.0, 0.0, unit[0]
    if point.robot.base == "freeflyer":
        turn = pin.Quaternion(point.q[3:7]).toRotationMatrix()
        acceleration = np.concatenate([turn.T @ acceleration[:3], turn.T @ acceleration[3:]])
    rows = list(contact.rows)
    return acceleration[rows], 0.0, 0.0, unit[rows]


def velocity_limits(point: Point, term: Any) -> RowsOf:
    limit = point.robot.velocity_limit[6:]
    return point.dxi[6:], -limit, limit, point.units.velocity[6:]


def acceleration_limits(point: Point, term: Any) -> RowsOf:
    return point.ddxi[6:], -term.limit[6:], term.limit[6:], point.units.acceleration[6:]


def jerk_limits(point: Point, term: Any) -> RowsOf:
    return point.dddxi[6:], -term.limit[6:], term.limit[6:], point.units.jerk[6:]


def torque_rate_limits(point: Point, term: Any) -> RowsOf:
    limit = 0.99 * term.limit[6:]
    return point.torque_rate, -limit, limit, point.units.torque / point.units.time


def of_joints(scale: Scale, order: int) -> np.ndarray:
    """Limits (8,) of the hopper's joints, the derivatives of that order of an angle and a length."""
    return np.array([INF] * 6 + [3.0, 2.0 * scale.length]) / scale.time**order


def centre(point: Point) -> np.ndarray:
    return pin.centerOfMass(point.robot.model, point.robot.model.createData(), point.q)


def momentum(point: Point) -> np.ndarray:
    model = point.robot.model
    return pin.computeCentroidalMomentum(model, model.createData(), point.q, point.v).vector


def torque_limits(point: Point, term: Any) -> RowsOf:
    return point.torque, -term.limit, term.limit, point.units.torque


def drive_limits(point: Point, term: Any) -> RowsOf:
    """The motor without limits has none; the joint of one without a drive keeps the robot's."""
    motor = point.robot.drives[0]
    torque, speed = point.torque[0] / motor.gear_ratio, point.v[6] * motor.gear_ratio
    voltage = torque / motor.stall_torque + speed / motor.no_load_speed
    return [voltage, torque / motor.torque_limit], -1.0, 1.0, 1.0


def pyramid(point: Point, term: Any) -> RowsOf:
    f, mu = point.on_surface, MU / math.sqrt(2)
    sides = [mu * f[2] - f[0], mu * f[2] + f[0], mu * f[2] - f[1], mu * f[2] + f[1]]
    return [f[2], *sides], 0.0, INF, point.units.force


def cone(point: Point, term: Any) -> RowsOf:
    f = point.on_surface / point.units.force
    largest = MU * f[2]
    side = (largest**2 - f[0] ** 2 - f[1] ** 2) / math.sqrt(largest**2 + APEX**2)
    return [f[2], side - TIGHT * math.exp(-((largest / TIP) ** 2))], 0.0, INF, 1.0


def in_sole(point: Point) -> tuple[np.ndarray, np.ndarray, float, float]:
    turn, contact = point.pose(FOOT).rotation, point.robot.contacts[0]
    return turn.T @ point.wrench[:3], turn.T @ point.wrench[3:], contact.half_length, contact.half_width


def sole_limits(point: Point, term: Any) -> RowsOf:
    _, m, x, y = in_sole(point)
    pressure = point.on_surface[2]
    arms = (y, x, MU * (x + y) / 2)
    rows = [arm * pressure + sign * m[i] for i, arm in enumerate(arms) for sign in (-1, 1)]
    return rows, 0.0, INF, point.units.torque


def sole_cone(point: Point, term: Any) -> RowsOf:
    """The eight rows of the yaw moment as the least of their two groups: sorted, as absolute values are."""
    f, m, x, y = in_sole(point)
    mu = MU / math.sqrt(2)
    friction = [mu * f[2] + sign * f[i] for i in (0, 1) for sign in (-1, 1)]
    pressure = [arm * f[2] + sign * m[i] for i, arm in ((0, y), (1, x)) for sign in (-1, 1)]
    yaw = []
    for way in (1, -1):
        across, along = y * f[0] - way * mu * m[0], x * f[1] - way * mu * m[1]
        held = mu * (x + y) * f[2] + way * m[2]
        yaw += [held - a * across - b * along for a in (1, -1) for b in (1, -1)]
    units = [point.units.force] * 4 + [point.units.torque] * 12
    return [*friction, *pressure, *yaw], 0.0, INF, units


def normal_force(point: Point, term: Any) -> RowsOf:
    return [point.on_surface[2]], term.lower, INF, point.units.force


def friction_law(point: Point, term: Any) -> RowsOf:
    f, slip = point.on_surface, point.surface.slip_speed
    v = point.surface.frame.T @ point.velocity(FOOT)[:3]
    law = f[:2] + MU * f[2] * v[:2] / math.sqrt(v[:2] @ v[:2] + slip**2)
    return [*law, f[2]], 0.0, [0.0, 0.0, INF], point.units.force


def pose(point: Point, term: Any) -> RowsOf:
    """2 tan(angle / 2) along the axis of the turn from the goal."""
    here, length = point.pose(FOOT), point.units.length
    turn = pin.log3(term.rotation.T @ here.rotation)
    angle = np.linalg.norm(turn)
    aim = [*term.position, 0, 0, 0]
    return [*here.translation, *(2 * math.tan(angle / 2) / angle * turn)], aim, aim, [length] * 3 + [1.0] * 3


def direction(point: Point, term: Any) -> RowsOf:
    cosine = np.array(term.direction) @ point.pose(FOOT).rotation @ term.axis
    return [cosine], math.cos(term.angle), INF, 1.0


def lands(point: Point, where: list[RowsOf], velocity: np.ndarray | None = None) -> RowsOf:
    """Rows of a landing: where, then that the contact does not move."""
    rows = list(point.robot.contacts[0].rows)
    moving = point.velocity(FOOT)[rows] if velocity is None else velocity
    unit = point.units.twist[rows] if velocity is None else point.units.twist[0]
    parts = [*where, (moving, 0.0, 0.0, unit)]
    each = [[np.broadcast_to(entry, np.shape(part[0])) for entry in part] for part in parts]
    return tuple(np.concatenate(column) for column in zip(*each, strict=True))


def foothold(point: Point, term: Any) -> RowsOf:
    place, radius = PLACE * point.scale.length, point.robot.contacts[0].radius
    height = slope(point.scale).surface.distance(place)
    centre = place - height * TILT + radius * TILT
    return lands(point, [(point.pose(FOOT).translation, centre, centre, point.units.length)])


def on_slope(point: Point, term: Any) -> RowsOf:
    level = term.terrain.surface.height + point.robot.contacts[0].radius
    row = ([TILT @ point.pose(FOOT).translation], level, level, point.units.length)
    v = point.velocity(FOOT)[:3]
    slides = getattr(point.surface, "slip_speed", None)
    return lands(point, [row], np.array([TILT @ v]) if slides else None)


def on_hills(point: Point, term: Any) -> RowsOf:
    place = point.pose(FOOT).translation
    return lands(point, [([place[2] - term.terrain.height(*place[:2])], 0.0, 0.0, point.units.length)])


def corners(point: Point) -> np.ndarray:
    here = point.pose(FOOT)
    return here.translation + point.robot.contacts[0].corners @ here.rotation[:, :2].T


def on_patch(point: Point, term: Any) -> RowsOf:
    turn, face = point.pose(FOOT).rotation, patch(point.scale)
    height, length = face.surface.height, point.units.length
    flat = ([point.pose(FOOT).translation[2]], height, height, length)
    level = (turn[2, :2], 0.0, 0.0, 1.0)
    inside = [(face.inward @ corner, face.offsets + face.margin, INF, length) for corner in corners(point)]
    return lands(point, [flat, level, *inside])


def patch(scale: Scale) -> Patch:
    size = (0.8 * scale.length, 0.6 * scale.length)
    return Patch.rectangle(PLACE * scale.length, size, yaw=0.4, margin=0.02 * scale.length)


def clears(point: Point, term: Any, s: float = 0.5, level: float = 0.0) -> RowsOf:
    """Height of the contact's points over the ground raised by its radius; `SwingArc` bounds n . p."""
    least, radius = term.height * 16 * s**2 * (1 - s) ** 2, point.robot.contacts[0].radius
    if isinstance(term.terrain, SmoothTerrain):
        ground = term.terrain.offset(radius)
        heights = [p[2] - float(ground.height(*p[:2])) for p in corners(point)]
    else:
        heights = corners(point) @ TILT - term.terrain.surface.height - radius + level
    return heights, least + level, INF, point.units.length


def arc(point: Point, term: Any) -> RowsOf:
    level = term.terrain.surface.height + point.robot.contacts[0].radius
    return clears(point, term, 0.2 + 0.5 * (0.8 - 0.2), level)


def over(point: Point, term: Any) -> RowsOf:
    """In the middle of a swing without edges: above both planes, measured vertically."""
    p, planes = corners(point)[0], (term.swings[0].ground.first, term.swings[0].ground.last)
    rows = [plane.normal @ p / plane.normal[2] for plane in planes]
    return rows, [plane.height / plane.normal[2] + term.height for plane in planes], INF, point.units.length


def swing(scale: Scale) -> terms.SwingCrossing:
    ground = Crossing(first=plane(TILT)(scale), last=plane(UP)(scale))
    parts = {"phase": (0.0, 1.0)}
    return terms.SwingCrossing(
        contact=FOOT, begin=0.0, end=1.0, parts=parts, ground=ground, risen=0.3, sinking=0.7
    )


def free(point: Point, q: np.ndarray, error: np.ndarray, contacts: tuple[str, ...] = (FOOT,)) -> RowsOf:
    """N^T error: the basis N is tested by itself."""
    return terms.free_directions(point.robot, q, contacts).T @ error, 0.0, 0.0, 1.0


def off(point: Point, q: np.ndarray) -> np.ndarray:
    """Difference (8,) of the hopper's local coordinates from q; of the rotation 2 tan(angle / 2)."""
    turn = pin.log3((pin.XYZQUATToSE3(q[:7]).inverse() * pin.XYZQUATToSE3(point.q[:7])).rotation)
    angle = np.linalg.norm(turn)
    apart = point.q[7:] - q[7:]
    return np.concatenate([point.q[:3] - q[:3], 2 * math.tan(angle / 2) / angle * turn, apart])


def terminal_velocity(point: Point, term: Any) -> RowsOf:
    """Rates of the goal: the linear velocity in world axes at the goal's orientation."""
    turn = pin.Quaternion(term.q[3:7]).toRotationMatrix()
    wanted = np.concatenate([turn @ term.v[:3], term.v[3:]])
    return free(point, term.q, (point.dxi - wanted) / point.units.velocity)


def terminal_posture(point: Point, term: Any) -> RowsOf:
    model, data = point.robot.model, point.robot.model.createData()
    pin.framesForwardKinematics(model, data, term.q)
    moved = point.pose(FOOT).translation - data.oMf[model.getFrameId(FOOT)].translation
    error = off(point, term.q)
    error[:2] -= moved[:2]
    return free(point, term.q, error / point.units.position)


# Cases

# Forces of sliding joints are over m g l, too, as torques are: other numbers on a longer robot.
OVER_TORQUE = {"same_on_similar": False}
# The basis of the directions that contacts leave free is orthonormal in m and rad, not over natural units.
IN_METRES = {"same_on_similar": False, "node": stands}


def cost(make: Any, residual: Any = None, **options: Any) -> Case:
    return Case(make=make, residual=residual, **options)


def rows(make: Any, formula: Any, **options: Any) -> Case:
    return Case(make=make, rows=formula, **options)


at_middle = {"at": middle_of("phase")}
CASES: dict[str, Case] = {
    "torque": cost(
        lambda s: terms.TorqueCost(weight=2.0), lambda p, t: p.torque / p.units.torque, **OVER_TORQUE
    ),
    "torque of drives": cost(
        lambda s: terms.TorqueCost(weight=2.0),
        lambda p, t: p.torque / p.units.torque,
        robot=driven,
        **OVER_TORQUE,
    ),
    "torque of an arm": cost(
        lambda s: terms.TorqueCost(weight=2.0),
        lambda p, t: p.torque / p.units.torque,
        robot=limited_arm,
        contact=False,
    ),
    "acceleration": cost(
        lambda s: terms.AccelerationCost(weight=2.0), lambda p, t: p.ddxi / p.units.acceleration
    ),
    "acceleration of joints": cost(
        lambda s: terms.AccelerationCost(weight=2.0, joints_only=True),
        lambda p, t: (p.ddxi / p.units.acceleration)[6:],
    ),
    "velocity": cost(lambda s: terms.VelocityCost(weight=2.0), lambda p, t: p.dxi / p.units.velocity),
    "velocity of joints": cost(
        lambda s: terms.VelocityCost(weight=2.0, joints_only=True),
        lambda p, t: (p.dxi / p.units.velocity)[6:],
    ),
    "posture": cost(lambda s: terms.PostureCost(weight=2.0, q=goal(s)), posture),
    "posture of a joint": cost(
        lambda s: terms.PostureCost(weight=2.0, q=goal(s), joints=("shank",)), lambda p, t: posture(p, t)[1:]
    ),
    "jerk": cost(lambda s: terms.JerkCost(weight=2.0), lambda p, t: p.dddxi / p.units.jerk, actuation="jerk"),
    "torque rate": cost(
        lambda s: terms.TorqueRateCost(weight=2.0),
        lambda p, t: p.torque_rate * p.units.time / p.units.torque,
        robot=driven,
        actuation="jerk",
        **OVER_TORQUE,
    ),
    "centre of mass along a path": cost(
        lambda s: terms.CentreOfMassCost(weight=2.0, path=lambda t: PLACE * s.length, axes="zx"),
        lambda p, t: ((centre(p) - PLACE * p.scale.length) / p.units.length)[[0, 2]],
    ),
    "momentum cost": cost(
        lambda s: terms.MomentumCost(weight=2.0, part="angular"),
        lambda p, t: momentum(p)[3:] / p.units.torque / p.units.time,
    ),
    "centre of mass": rows(
        lambda s: terms.CentreOfMass(position=PLACE * s.length, axes="yz", **at_middle),
        lambda p, t: (centre(p)[1:], t.position[1:], t.position[1:], p.units.length),
        node=node,
    ),
    "momentum": rows(
        lambda s: terms.Momentum(part="linear", momentum=PLACE * s.mass * s.length / s.time, **at_middle),
        lambda p, t: (momentum(p)[:3], t.momentum, t.momentum, p.units.force * p.units.time),
        node=node,
    ),
    "acceleration limits": rows(
        lambda s: terms.AccelerationLimits(limit=of_joints(s, 2)), acceleration_limits
    ),
    "jerk limits": rows(lambda s: terms.JerkLimits(limit=of_joints(s, 3)), jerk_limits, actuation="jerk"),
    "torque rate limits": rows(
        lambda s: terms.TorqueRateLimits(limit=of_joints(s, 1) * s.torque),
        torque_rate_limits,
        actuation="jerk",
        **OVER_TORQUE,
    ),
    "wrench": cost(lambda s: terms.WrenchCost(weight=2.0), wrench),
    "wrench of a sole": cost(lambda s: terms.WrenchCost(weight=2.0), wrench, robot=sole),
    "time": cost(lambda s: terms.TimeCost(weight=2.0), lambda p, t: np.ones(1)),
    "impulse": cost(lambda s: terms.ImpulseCost(weight=2.0), wrench, robot=sole, place=Place.IMPACT),
    "motor torque": cost(
        lambda s: terms.MotorTorqueCost(weight=2.0), motor_torque, robot=driven, **OVER_TORQUE
    ),
    "power": Case(make=lambda s: terms.PowerCost(weight=2.0, recovered=0.3), value=power, robot=driven),
    "tracking": cost(lambda s: terms.TrackingCost(weight=2.0, reference=lambda t: goal(s)), tracking),
    "height": Case(
        make=lambda s: terms.FrameHeightCost(weight=2.0, frame=FOOT, **at_middle),
        value=lambda p, t: -t.weight * p.pose(FOOT).translation[2] / p.units.length,
        node=node,
    ),
    "distance": Case(
        make=lambda s: terms.DistanceCost(weight=2.0, frame=FOOT, direction=tuple(TILT), **at_middle),
        value=lambda p, t: -t.weight * TILT @ p.pose(FOOT).translation / p.units.length,
        node=node,
    ),
    "base dynamics": rows(lambda s: terms.BaseDynamics(), base),
    "base dynamics on a sole": rows(lambda s: terms.BaseDynamics(), base, robot=sole),
    "base dynamics in a plane": rows(lambda s: terms.BaseDynamics(), base, robot=planar_hopper),
    "base statics": rows(lambda s: terms.BaseDynamics(), base, actuation="velocity"),
    "contact acceleration": rows(lambda s: terms.ContactAcceleration(), still),
    "contact acceleration of a sole": rows(lambda s: terms.ContactAcceleration(), still, robot=sole),
    "contact acceleration in a plane": rows(
        lambda s: terms.ContactAcceleration(), still, robot=planar_hopper
    ),
    "contact acceleration of a sliding contact": rows(
        lambda s: terms.ContactAcceleration(), still, surface=sliding
    ),
    "contact velocity": rows(
        lambda s: terms.ContactVelocity(),
        lambda p, t: (p.velocity(FOOT), 0.0, 0.0, p.units.twist),
        robot=sole,
        actuation="velocity",
    ),
    "impact": rows(
        lambda s: terms.ImpactDynamics(),
        lambda p, t: (p.forces, 0.0, 0.0, p.units.generalized_force),
        place=Place.IMPACT,
    ),
    "position limits": rows(
        lambda s: terms.PositionLimits(),
        lambda p, t: (p.xi[6:], p.robot.position_lower[7:], p.robot.position_upper[7:], p.units.position[6:]),
    ),
    "velocity limits": rows(lambda s: terms.VelocityLimits(), velocity_limits),
    "torque limits": rows(
        lambda s: terms.TorqueLimits(limit=s.torque * np.array([3.0, 5.0])),
        torque_limits,
        robot=driven,
        **OVER_TORQUE,
    ),
    "drive limits": rows(lambda s: terms.DriveLimits(), drive_limits, robot=driven),
    "friction pyramid": rows(lambda s: terms.FrictionPyramid(), pyramid, surface=plane(UP)),
    "friction pyramid on a slope": rows(
        lambda s: terms.FrictionPyramid(friction=MU), pyramid, surface=plane(TILT)
    ),
    "friction pyramid on hills": rows(
        lambda s: terms.FrictionPyramid(contacts=(FOOT,)), pyramid, surface=lambda s: hills(s).surface
    ),
    "friction pyramid of impulses": rows(
        lambda s: terms.FrictionPyramid(), pyramid, surface=plane(TILT), place=Place.IMPACT
    ),
    "friction cone": rows(lambda s: terms.FrictionCone(friction=MU), cone),
    "friction cone on a slope": rows(lambda s: terms.FrictionCone(), cone, surface=plane(TILT)),
    "friction cone on hills": rows(lambda s: terms.FrictionCone(), cone, surface=lambda s: hills(s).surface),
    "sole limits": rows(lambda s: terms.SoleLimits(), sole_limits, robot=sole, surface=plane(TILT)),
    "sole cone": rows(lambda s: terms.SoleCone(), sole_cone, robot=sole, surface=plane(TILT)),
    "normal force": rows(
        lambda s: terms.NormalForce(contact=FOOT, lower=3.0 * s.mass), normal_force, surface=plane(TILT)
    ),
    "friction of a sliding contact": rows(lambda s: terms.SlidingFriction(), friction_law, surface=sliding),
    "frame height": rows(
        lambda s: terms.FrameHeight(frame=FOOT, height=0.3 * s.length, **at_middle),
        lambda p, t: ([p.pose(FOOT).translation[2]], t.height, INF, p.units.length),
        node=node,
    ),
    "frame height from above": rows(
        lambda s: terms.FrameHeight(frame=FOOT, height=0.3 * s.length, below=True, **at_middle),
        lambda p, t: ([p.pose(FOOT).translation[2]], -INF, t.height, p.units.length),
        node=node,
    ),
    "frame pose": rows(
        lambda s: terms.FramePose(frame=FOOT, position=s.length * PLACE, rotation=TURN, **at_middle),
        pose,
        node=node,
    ),
    "frame velocity": rows(
        lambda s: terms.FrameVelocity(
            frame=FOOT, velocity=TWIST * [*[s.length] * 3, *[1.0] * 3] / s.time, **at_middle
        ),
        lambda p, t: (p.velocity(FOOT), t.velocity, t.velocity, p.units.twist),
        node=node,
    ),
    "frames above": rows(
        lambda s: terms.FramesAbove(frames=(FOOT, FOOT), height=0.1 * s.length),
        lambda p, t: ([p.pose(FOOT).translation[2]] * 2, t.height, INF, p.units.length),
        node=node,
    ),
    "frame direction": rows(
        lambda s: terms.FrameDirection(
            frame=FOOT, axis=tuple(TILT), direction=(0.0, 0.0, 2.0), angle=0.4, **at_middle
        ),
        direction,
        node=node,
    ),
    "landing on a foothold": rows(
        lambda s: terms.ContactLanding(at=start_of("phase"), contacts=(FOOT,), terrain=slope(s)),
        foothold,
        robot=ball,
        node=lambda s: stands(s, 0, footholds={FOOT: projected(s)}, surfaces={FOOT: slope(s).surface}),
    ),
    "landing on a slope": rows(
        lambda s: terms.ContactLanding(at=start_of("phase"), contacts=(FOOT,), terrain=slope(s)),
        on_slope,
        robot=ball,
        node=lambda s: stands(s, 0),
    ),
    "landing of a sliding contact": rows(
        lambda s: terms.ContactLanding(at=start_of("phase"), contacts=(FOOT,), terrain=slope(s)),
        on_slope,
        surface=sliding,
        node=lambda s: stands(s, 0),
    ),
    "landing on hills": rows(
        lambda s: terms.ContactLanding(at=start_of("phase"), contacts=(FOOT,), terrain=hills(s)),
        on_hills,
        surface=lambda s: hills(s).surface,
        node=lambda s: stands(s, 0),
    ),
    "landing on a patch": rows(
        lambda s: terms.ContactLanding(at=start_of("phase"), contacts=(FOOT,), terrain=FlatGround()),
        on_patch,
        robot=sole,
        node=lambda s: stands(s, 0, patches={FOOT: patch(s)}),
    ),
    "swing clearance": rows(
        lambda s: terms.SwingClearance(height=0.1 * s.length, terrain=slope(s)), clears, robot=sole, node=node
    ),
    "swing clearance of a ball over hills": rows(
        lambda s: terms.SwingClearance(height=0.1 * s.length, terrain=hills(s)), clears, robot=ball, node=node
    ),
    "swing arc": rows(
        lambda s: terms.SwingArc(
            height=0.1 * s.length, terrain=slope(s), parts={"phase": (terms.SwingPart(FOOT, 0.2, 0.8),)}
        ),
        arc,
        robot=ball,
        node=node,
    ),
    "swing over planes": rows(
        lambda s: terms.SwingOver(height=0.1 * s.length, swings=(swing(s),)), over, node=node
    ),
    "terminal state": rows(
        lambda s: terms.TerminalState(q=goal(s)),
        lambda p, t: free(p, t.q, off(p, t.q) / p.units.position),
        **IN_METRES,
    ),
    "terminal state in the air": rows(
        lambda s: terms.TerminalState(q=goal(s)),
        lambda p, t: (off(p, t.q) / p.units.position, 0.0, 0.0, 1.0),
        node=node,
    ),
    "terminal rest": rows(
        lambda s: terms.TerminalRest(q=goal(s)),
        lambda p, t: free(p, t.q, p.dxi / p.units.velocity),
        **IN_METRES,
    ),
    "terminal velocity": rows(
        lambda s: terms.TerminalVelocity(q=goal(s), v=rates(s)), terminal_velocity, **IN_METRES
    ),
    "terminal line": rows(
        lambda s: terms.TerminalLinear(
            position=np.eye(8)[:1], velocity=-0.5 * s.time * np.eye(8)[1:2], value=np.array([0.3 * s.length])
        ),
        lambda p, t: (
            np.array([p.xi[0] - 0.5 * p.scale.time * p.dxi[1] - 0.3 * p.scale.length]),
            0.0,
            0.0,
            max(p.units.position[0], 0.5 * p.scale.time * p.units.velocity[1]),
        ),
        node=node,
    ),
    "terminal posture": rows(
        lambda s: terms.TerminalPosture(q=goal(s), over=FOOT), terminal_posture, **IN_METRES
    ),
}


def projected(scale: Scale) -> np.ndarray:
    """The place on the slope."""
    place = PLACE * scale.length
    return place - slope(scale).surface.distance(place) * TILT
