"""Terms at random points: their expressions as a transcription evaluates them, and numeric Pinocchio."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from tests.support.problems import FOOT, hopper
from trajopt.dynamics.manifold import Coordinates
from trajopt.dynamics.model_quantities import generalized_force
from trajopt.reduced.term_reader import on_inputs
from trajopt.robot.robot import Robot
from trajopt.robot.units import Units
from trajopt.terms import Context, Cost, NodeCost, NodePlace, Rows, Term
from trajopt.terms.context_symbols import Actuation, Place
from trajopt.terrain import FlatGround, Ground

# A duration that is free is this multiple of the nominal one.
TIME_SCALE = 1.3
# Weights of central differences of eighth order, and their step in natural time: rounding and the ninth
# derivative are below 1e-11.
EIGHTH_ORDER, SHARE_OF_TIME = (4 / 5, -1 / 5, 4 / 105, -1 / 280), 0.02


@dataclass(frozen=True)
class Scale:
    """How much longer and heavier a similar robot is; under the same gravity, times and rates follow."""

    length: float = 1.0
    mass: float = 1.0

    @property
    def time(self) -> float:
        return self.length**0.5

    @property
    def torque(self) -> float:
        return self.mass * self.length


def _linear(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of q and of v are lengths and their rates."""
    q, v = np.zeros(model.nq, dtype=bool), np.zeros(model.nv, dtype=bool)
    for joint in list(model.joints)[1:]:
        kind = joint.shortname().removeprefix("JointModel")
        count = 3 if kind == "FreeFlyer" else 2 if kind == "Planar" else int(kind.startswith("P"))
        q[joint.idx_q : joint.idx_q + count] = v[joint.idx_v : joint.idx_v + count] = True
    return q, v


def similar(robot: Robot, scale: Scale) -> Robot:
    """The robot with all lengths and masses multiplied, and all limits so that its motions are similar."""
    model, (q_linear, v_linear) = robot.model.copy(), _linear(robot.model)
    for index in range(1, model.njoints):
        place, inertia = model.jointPlacements[index], model.inertias[index]
        model.jointPlacements[index] = pin.SE3(place.rotation, scale.length * place.translation)
        turning = scale.mass * scale.length**2 * inertia.inertia
        model.inertias[index] = pin.Inertia(scale.mass * inertia.mass, scale.length * inertia.lever, turning)
    for frame in model.frames:
        frame.placement = pin.SE3(frame.placement.rotation, scale.length * frame.placement.translation)
    model.armature *= scale.mass * np.where(v_linear, 1.0, scale.length**2)
    of_q = np.where(q_linear, scale.length, 1.0)
    actuated = v_linear[robot.n_unactuated :]
    drives = robot.drives and tuple(
        drive
        and replace(
            drive,
            torque_limit=drive.torque_limit * scale.torque,
            stall_torque=drive.stall_torque * scale.torque,
            no_load_speed=drive.no_load_speed / scale.time,
            viscous_friction=drive.viscous_friction * scale.torque * scale.time,
            coulomb_friction=drive.coulomb_friction * scale.torque,
            coulomb_speed=drive.coulomb_speed / scale.time,
        )
        for drive in robot.drives
    )
    return replace(
        robot,
        model=model,
        reference=robot.reference * of_q,
        velocity_limit=robot.velocity_limit * np.where(v_linear, scale.length, 1.0) / scale.time,
        position_lower=robot.position_lower * of_q,
        position_upper=robot.position_upper * of_q,
        torque_limit=robot.torque_limit * scale.mass * np.where(actuated, 1.0, scale.length),
        contacts=tuple(
            replace(
                contact,
                half_length=scale.length * contact.half_length,
                half_width=scale.length * contact.half_width,
                radius=scale.length * contact.radius,
            )
            for contact in robot.contacts
        ),
        given_length=scale.length * robot.length,
        drives=drives,
    )


@dataclass(frozen=True, eq=False)
class Point:
    """A collocation point, node or impact in numbers; of a velocity source rates are zero in forces."""

    robot: Robot
    scale: Scale
    surface: Ground
    xi: np.ndarray
    dxi: np.ndarray
    ddxi: np.ndarray
    dddxi: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    wrench: np.ndarray
    place: Place
    actuation: Actuation
    units: Units
    # The motion after a time in s at constant jerks and rates of wrenches.
    later: Callable[[float], "Point"] | None = None

    @cached_property
    def data(self) -> pin.Data:
        data = self.robot.model.createData()
        pin.forwardKinematics(self.robot.model, data, self.q, self.v, self.a)
        pin.updateFramePlacements(self.robot.model, data)
        return data

    def pose(self, frame: str) -> pin.SE3:
        return self.data.oMf[self.robot.model.getFrameId(frame)]

    def velocity(self, frame: str) -> np.ndarray:
        identity = self.robot.model.getFrameId(frame)
        model = self.robot.model
        return pin.getFrameVelocity(model, self.data, identity, pin.LOCAL_WORLD_ALIGNED).vector

    def acceleration(self, frame: str) -> np.ndarray:
        identity, model = self.robot.model.getFrameId(frame), self.robot.model
        return pin.getFrameClassicalAcceleration(model, self.data, identity, pin.LOCAL_WORLD_ALIGNED).vector

    @cached_property
    def forces(self) -> np.ndarray:
        """Generalised forces (nv,): RNEA - J^T f, at rest of a velocity source, M dv - J^T f at an impact."""
        model, still = self.robot.model.copy(), np.zeros(self.robot.nv)
        if self.place is Place.IMPACT:
            model.gravity = pin.Motion.Zero()
        moves = self.place is Place.POINT and self.actuation != "velocity"
        motion = (self.q, self.v if moves else still, self.a)
        active = [model.getFrameId(contact.frame) for contact in self.robot.contacts]
        return generalized_force(model, model.createData(), motion, active, self.wrench[None][: len(active)])

    @property
    def torque(self) -> np.ndarray:
        """Torques (nu,) of the drives: the actuated rows and the joints' friction."""
        unactuated, drives = self.robot.n_unactuated, self.robot.drives
        friction = [d.friction_torque(r) for d, r in zip(drives or (), self.v[unactuated:], strict=False)]
        return self.forces[unactuated:] + (np.array(friction) if drives else 0.0)

    @property
    def torque_rate(self) -> np.ndarray:
        """Rates (nu,) of the torques, by central differences of eighth order."""
        step = SHARE_OF_TIME * self.units.time
        return sum(
            weight / step * (self.later(k * step).torque - self.later(-k * step).torque)
            for k, weight in enumerate(EIGHTH_ORDER, 1)
        )

    @property
    def on_surface(self) -> np.ndarray:
        """The force (3,) along the surface's two tangents and its normal."""
        plane = self.surface.plane_at(self.pose(FOOT).translation)
        return plane.frame.T @ self.wrench[:3]


# What a row is expected to be: its value, bounds and natural unit.
RowsOf = tuple[Any, Any, Any, Any]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A term with the formula of its docstring in NumPy.

    Args:
        make: the term, for a robot of that scale.
        residual: of a cost, r (n,) in w |r|^2 / n.
        value: of a cost, where it is no mean of squares.
        rows: of a constraint: values, lower and upper bounds, units.
        robot: at scale one.
        surface: what the robot's contact touches.
        node: place of a term at nodes.
        contact: whether the contact is active.
        same_on_similar: the term is the same in natural units on a similar robot.
    """

    make: Callable[[Scale], Any]
    residual: Callable[[Point, Any], Any] | None = None
    value: Callable[[Point, Any], float] | None = None
    rows: Callable[[Point, Any], RowsOf] | None = None
    robot: Callable[[], Robot] = hopper
    surface: Callable[[Scale], Ground] = lambda scale: FlatGround().surface
    node: Callable[[Scale], NodePlace] | None = None
    place: Place = Place.POINT
    actuation: Actuation = "torque"
    contact: bool = True
    same_on_similar: bool = True


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A case's term for a robot of some scale, as symbols and as a function of a point's inputs z."""

    case: Case
    scale: Scale = Scale()
    contact: bool | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def robot(self) -> Robot:
        return similar(self.case.robot(), self.scale)

    @cached_property
    def term(self) -> Term:
        return replace(self.case.make(self.scale), **self.changes)

    @cached_property
    def units(self) -> Units:
        units = Units(self.robot)
        return units.impulsive() if self.case.place is Place.IMPACT else units

    @cached_property
    def context(self) -> Context:
        case = self.case
        active = case.contact if self.contact is None else self.contact
        place = Place.NODE if case.node else case.place
        on_node = {contact.name: case.surface(self.scale) for contact in self.robot.contacts}
        return Context(
            self.robot,
            Coordinates(self.robot.model),
            self.robot.contacts if active and place is not Place.NODE else (),
            place=place,
            time_scales=(1, 0),
            actuation=case.actuation,
            surfaces=on_node if active else {},
        )

    @cached_property
    def result(self) -> Rows | ca.SX | None:
        """Rows of a constraint, value of a cost."""
        arguments = (self.context, self.units, *([self.case.node(self.scale)] if self.case.node else []))
        if isinstance(self.term, Cost | NodeCost):
            return self.term.value(*arguments)
        return self.term.rows(*arguments)

    @property
    def expression(self) -> ca.SX:
        return self.result.expression if isinstance(self.result, Rows) else self.result

    @cached_property
    def function(self) -> ca.Function:
        """z -> (value, Jacobian)."""
        expression = self.expression
        z, (value,) = on_inputs(self.context, expression, [self.context.parameter_values])
        return ca.Function("term", [z], [value, ca.jacobian(value, z)])

    def at(self, z: np.ndarray) -> np.ndarray:
        return np.array(self.function(z)[0]).ravel()

    def _pinocchio(self, *local: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(row[0] for row in self.context.coordinates.local_to_pinocchio(*(x[None] for x in local)))

    def point(self, seed: int, size: float = 1.0) -> tuple[np.ndarray, Point]:
        """Inputs z of order one in natural units, times ``size``, and the same point in numbers."""
        random, context, units = np.random.default_rng(seed), self.context, self.units
        coordinates, place = context.coordinates, context.place
        rotations = random.normal(size=(coordinates.n_rotations, 4)) + np.array([0.0, 0.0, 0.0, 2.0])
        rotations = (rotations / np.linalg.norm(rotations, axis=1)[:, None]).ravel()
        xi, dxi, ddxi = (
            size * random.uniform(-0.5, 0.5, self.robot.nv) * unit
            for unit in (units.position, units.velocity, units.acceleration)
        )
        if place is Place.NODE:
            xi[coordinates.rotation_index], ddxi = 0.0, np.zeros_like(ddxi)
        if place is Place.IMPACT:
            ddxi = ddxi / units.acceleration * units.velocity  # the jump of the rates
        contacts = {contact.name: contact for contact in context.contacts}
        wrench = np.zeros(6)
        for contact in contacts.values():
            rows = list(contact.rows)
            wrench[rows] = size * random.uniform(-0.5, 1.0, len(rows)) * units.wrench[rows]
        held = [wrench[list(contact.rows)] for contact in contacts.values()]
        order = 1 if place is Place.IMPACT else 2
        jerks = self.case.actuation == "jerk" and place is Place.POINT
        third = size * random.uniform(-0.5, 0.5, self.robot.nv) * units.jerk
        velocity_source = self.case.actuation == "velocity"
        second = [] if velocity_source or place is Place.NODE else [ddxi * TIME_SCALE**order]
        start = xi[coordinates.additive_index] if place is Place.NODE else xi
        rates = [] if velocity_source and place is Place.NODE else [dxi * TIME_SCALE]
        second += [third * TIME_SCALE**3] if jerks else []
        change = wrench * random.uniform(-0.5, 0.5, 6) / units.time
        held += [TIME_SCALE * change[list(c.rows)] for c in contacts.values()] if jerks else []
        z = np.concatenate([rotations, start, *rates, *second, *held, [TIME_SCALE]])
        after = dxi + ddxi if place is Place.IMPACT else dxi
        q, v, a = self._pinocchio(rotations, xi, after, ddxi)
        if place is Place.IMPACT:
            a = self._pinocchio(rotations, xi, np.zeros_like(dxi), ddxi)[2]
        a = np.zeros_like(a) if velocity_source else a
        surface, actuation, motion = (
            self.case.surface(self.scale),
            self.case.actuation,
            (xi, dxi, ddxi, third),
        )
        known = place, actuation, units

        def later(h: float) -> Point:
            moved = (
                xi + h * dxi + h**2 / 2 * ddxi + h**3 / 6 * third,
                dxi + h * ddxi + h**2 / 2 * third,
                ddxi + h * third,
            )
            state, loaded = self._pinocchio(rotations, *moved), wrench + h * change
            return Point(self.robot, self.scale, surface, *moved, third, *state, loaded, *known)

        return z, Point(
            self.robot, self.scale, surface, *motion, q, v, a, wrench, *known, later if jerks else None
        )
