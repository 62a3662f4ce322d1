"""Inputs of a term at one point: symbols of the state, and of the robot's functions of it.

Terms are written in two layers. The robot's functions (generalised forces, contact placements, velocities,
accelerations) are *symbols* here. Their graph is joined and differentiated once for all terms, in
`trajopt.transcription.stage_functions`, so that a term stays a small expression.
"""

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType

import casadi as ca
import numpy as np

from trajopt.dynamics.manifold import Coordinates
from trajopt.errors import InputError
from trajopt.robot.actuators.on_robot import drive_torque
from trajopt.robot.contact import Contact
from trajopt.robot.link_wrench import LinkWrench
from trajopt.robot.robot import Robot
from trajopt.robot.stance.minimal_coordinates import StanceMode
from trajopt.robot.validation import require_configuration
from trajopt.terms.context_symbols import ORDERS, Actuation, FrameSymbols, Parameters, Place, without_rolling
from trajopt.terrain.surface import Surface
from trajopt.terrain.terrain import Ground


class Context(Parameters):
    """Symbols of one collocation point, node or impact.

    At a collocation point the inputs ``z`` are (rotations, xi and its derivatives, wrenches and their rates,
    time scale); at a node they are its variables; at an impact (rotations, xi, rates before, jump of the
    rates, impulses, time scale). Entries that a problem lacks (the time scale of a fixed duration, xi'' of a
    velocity source, third derivatives and wrenches' rates unless jerks are the input) are left out. ``xi``
    (nv) are local coordinates (see `trajopt.dynamics.manifold`), ``dxi``, ``ddxi``, ``dddxi`` their
    derivatives in true time; ``q``, ``v``, ``a`` are Pinocchio's. Wrenches act on the robot, in world axes at
    the contact frame's origin, N and N m (impulses N s and N m s).

    Args:
        robot: the robot, in the coordinates used here.
        coordinates: local coordinates of the robot.
        contacts: active contacts whose wrenches are variables.
        node: shorthand for ``place=Place.NODE``.
        place: where the symbols are evaluated, default a collocation point.
        time_scales: number of time scales in a node, and the index of this phase's (None in nominal time).
        actuation: the control input.
        surfaces: the ground that each active contact touches, by the contact's name.
        mode: minimal coordinates of the phase, None for the whole robot's.
        kept_rows: independent rows of each contact's motion, by the contact's name; default all.
        near: state of a node (n_node,) from which goals take their whole turns; None for no whole turns.
        guess: the guess's configuration (nq,) at a node, evaluated on demand.
        given: known wrenches on links; they are parameters, and no impulses.
    """

    def __init__(
        self,
        robot: Robot,
        coordinates: Coordinates,
        contacts: tuple[Contact, ...] = (),
        *,
        node: bool = False,
        place: Place | None = None,
        time_scales: tuple[int, int | None] = (0, None),
        actuation: Actuation = "torque",
        surfaces: Mapping[str, Ground] = MappingProxyType({}),
        mode: StanceMode | None = None,
        kept_rows: Mapping[str, tuple[int, ...]] = MappingProxyType({}),
        near: np.ndarray | None = None,
        guess: Callable[[], np.ndarray] | None = None,
        given: tuple[LinkWrench, ...] = (),
    ) -> None:
        super().__init__()
        self.robot, self.coordinates, self.contacts, self.near = robot, coordinates, contacts, near
        self.guess = guess
        self.place = place or (Place.NODE if node else Place.POINT)
        self.actuation, self._surfaces, self._kept_rows = actuation, surfaces, kept_rows
        self.given = () if self.place is Place.IMPACT else given
        # The first parameters: the robot's functions depend on them.
        self.given_wrenches = ca.vertcat(ca.SX(0, 1), *[self.varying(wrench.at, 6) for wrench in self.given])
        scale = ca.SX.sym("time_scale", 0 if time_scales[1] is None else 1)
        self.time_scale = scale if scale.numel() else ca.SX(1)
        nv, order = coordinates.nv, ORDERS[actuation]
        names = () if self.place is Place.NODE else tuple((c.name, c.dimension) for c in contacts)
        # Symbols are named by their number, so that layers of other contacts are the same function.
        self.unknown_wrenches = {name: ca.SX.sym(f"w{i}", n) for i, (name, n) in enumerate(names)}
        rated = names if order == 3 and self.place is Place.POINT else ()
        self._wrench_rates = [ca.SX.sym(f"dw{i}", n) for i, (_, n) in enumerate(rated)]
        self._mode = mode if mode is not None and mode.robot is robot else None
        if self.place is Place.NODE:
            state = ca.SX.sym("x", coordinates.n_node + (order - 2) * nv)
            every = ca.SX.sym("time_scales", time_scales[0])
            self.time_scale = self.time_scale if time_scales[1] is None else every[time_scales[1]]
            self.z = ca.vertcat(state, every)
            full = ca.vertcat(state, ca.SX.zeros((3 - order) * nv))
            self.rotations, self.xi, rates = coordinates.split_node(full[: coordinates.n_node])
            highest, third = full[coordinates.n_node :], ca.SX.zeros(nv)
        else:
            self.rotations = ca.SX.sym("r", 4 * coordinates.n_rotations)
            self.xi, rates = ca.SX.sym("xi", nv), ca.SX.sym("dxi", nv)
            highest = ca.SX.sym("ddxi", nv if order >= 2 else 0)
            third = ca.SX.sym("dddxi", nv if order == 3 and self.place is Place.POINT else 0)
            wrenches = *self.unknown_wrenches.values(), *self._wrench_rates
            self.z = ca.vertcat(self.rotations, self.xi, rates, highest, third, *wrenches, scale)
        self._rates = rates / self.time_scale
        power = 1 if self.place is Place.IMPACT else 2
        self._highest = highest / self.time_scale**power if highest.numel() else ca.SX.zeros(nv)
        self._third = third / self.time_scale**3
        self._generalized_forces: ca.SX | None = None
        self._force_rates: ca.SX | None = None
        self._accelerations: dict[Contact, ca.SX] = {}
        self._frames: dict[str, FrameSymbols] = {}
        self._squares: list[tuple[ca.SX, ca.SX]] = []

    @property
    def dxi(self) -> ca.SX:
        """Rates of the local coordinates (nv,); at an impact, those before the jump."""
        if self.actuation == "velocity" and self.place is Place.NODE:
            raise InputError(
                "a term asks for rates at a node, where a velocity source has none",
                "allowed: terms about configurations there, or another actuation",
            )
        return self._rates

    @property
    def rates(self) -> ca.SX:
        """Rates (nv,) for a change of coordinates; zero if a node has none."""
        return self._rates

    @property
    def second(self) -> ca.SX:
        """Second derivatives (nv,) for a change of coordinates; zero if a node has none."""
        return self._highest

    @property
    def ddxi(self) -> ca.SX:
        """Second derivatives of the local coordinates (nv,); zero at a node, unless jerks are the input."""
        if self.actuation == "velocity":
            raise InputError(
                "a term asks for accelerations, which a source of velocity does not have",
                "allowed: terms about configurations and rates, or another actuation",
            )
        return self._highest

    @property
    def dddxi(self) -> ca.SX:
        """Third derivatives of the local coordinates (nv,), at points where jerks are the input."""
        if self.actuation != "jerk" or self.place is not Place.POINT:
            raise InputError(
                f"a term asks for jerks at a {self.place.value} with actuation '{self.actuation}'",
                "allowed: collocation points of actuation 'jerk'",
            )
        return self._third

    @property
    def jump(self) -> ca.SX:
        """Jump of the rates at an impact (nv,)."""
        return self._highest

    @property
    def loaded_contacts(self) -> tuple[Contact, ...]:
        """Active contacts with a wrench: a variable, or the reaction of an embedded contact."""
        if self._mode is None or self.place is not Place.POINT:
            return self.contacts
        return (*self.contacts, self._mode.embedded)

    def contact(self, name: str) -> Contact:
        """The contact of that name, in these coordinates or embedded in them. Raises `InputError`."""
        for contact in self.loaded_contacts:
            if contact.name == name:
                return contact
        return (self._mode.floating if self._mode else self.robot).contact(name)

    def actuated(self, values: np.ndarray) -> np.ndarray:
        """Values (nu,) of the whole robot's actuated rows, in the order of this context's torques."""
        rows = np.array(values, dtype=float)
        if rows.shape != (self.robot.nu,):
            raise InputError(
                f"a term has values of shape {rows.shape} for the actuated joints",
                f"allowed: ({self.robot.nu},)",
            )
        return rows if self._mode is None else rows[self._mode.torque_rows]

    def posture(self, q: np.ndarray) -> np.ndarray:
        """A configuration of the whole robot in the coordinates of this context (nq,). Raises InputError."""
        given, whole = np.array(q, dtype=float), self.robot if self._mode is None else self._mode.floating
        if given.shape != (whole.nq,):
            raise InputError(f"a term's posture has shape {given.shape}", f"allowed: ({whole.nq},)")
        require_configuration(whole.model, given, "a term's posture")
        return given if self._mode is None else self._mode.dropped(given)[0]

    @cached_property
    def wrenches(self) -> dict[str, ca.SX]:
        """Wrench of every loaded contact: 3 or 6 entries, world axes, N and N m; none at a node."""
        if self.place is Place.NODE:
            return {}
        full = dict(self.unknown_wrenches)
        for contact in self.contacts:
            if not contact.transmits_all:  # a contact within a plane transmits some components only
                full[contact.name] = ca.SX.zeros(3 if contact.kind == "point" else 6)
                full[contact.name][list(contact.rows)] = self.unknown_wrenches[contact.name]
        if self._mode is None or self.place is not Place.POINT:
            return full
        rates = self.v if self.moving else ca.SX.zeros(self.coordinates.nv)
        force = self._mode.reaction(self.q, rates, self.a)
        for wrench in full.values():
            force = force - wrench[:3]
        return full | {self._mode.embedded.name: force}

    def held_rows(self, contact: Contact) -> tuple[int, ...]:
        """Rows of an active contact's motion that do not depend on other contacts (see ``redundancy``)."""
        if self.slides_on(contact) is not None:
            return contact.rows
        return self._kept_rows.get(contact.name, contact.rows)

    def slides_on(self, contact: Contact) -> Surface | None:
        """The surface along which an active contact slides (see `SlidingFriction`), None if it is held."""
        surface = self._surfaces.get(contact.name)
        return surface if isinstance(surface, Surface) and surface.slip_speed is not None else None

    def surface(self, contact: Contact) -> Ground:
        """The surface, or curved ground, that an active contact touches."""
        return self._surfaces[contact.name]

    @cached_property
    def _configuration(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        rates = self._rates + self.jump if self.place is Place.IMPACT else self._rates
        return self.coordinates.to_pinocchio(self.rotations, self.xi, rates, self._highest)

    @property
    def q(self) -> ca.SX:
        """Pinocchio's configuration (nq,); built on first use."""
        return self._configuration[0]

    @property
    def v(self) -> ca.SX:
        """Pinocchio's velocity (nv,); after the jump at an impact."""
        return self._configuration[1]

    @property
    def a(self) -> ca.SX:
        """Pinocchio's acceleration (nv,), zero for a velocity source; at an impact the jump of v."""
        still = ca.SX.zeros(self.coordinates.nv)
        if self.actuation == "velocity":
            return still
        if self.place is not Place.IMPACT:
            return self._configuration[2]
        return self.coordinates.to_pinocchio(self.rotations, self.xi, still, self.jump)[2]

    @property
    def moving(self) -> bool:
        """Whether velocities enter the dynamics: not for a velocity source, nor at an impact."""
        return self.actuation != "velocity" and self.place is not Place.IMPACT

    @property
    def generalized_forces(self) -> ca.SX:
        """RNEA(q, v, a) minus J^T w of contacts and known wrenches, (nv,): base rows first, then joints.

        For a velocity source this is static, RNEA(q, 0, 0) - J^T w; at an impact, M (v+ - v-) - J^T impulses.
        """
        if self._generalized_forces is None:
            self._generalized_forces = ca.SX.sym("tau", self.coordinates.nv)
        return self._generalized_forces

    @property
    def base_rows(self) -> ca.SX:
        """Residual of the generalised forces that no input can produce; the dynamics hold if it vanishes."""
        actuation = self.robot.actuation
        if actuation.is_selection:
            return self._made_by_inputs[actuation.free.tolist()]
        return ca.mtimes(ca.DM(actuation.balance), self._made_by_inputs)

    @property
    def _made_by_inputs(self) -> ca.SX:
        """Generalised forces (nv,) without those of springs and friction at joints."""
        if not self.robot.joint_forces or self.place is Place.IMPACT:
            return self.generalized_forces
        forces = ca.SX(self.generalized_forces)
        for force in self.robot.joint_forces:
            _, row = force.entries(self.robot.model)
            forces[row] -= force.symbol(self.xi[row], self.dxi[row] if self.moving else None)
        return forces

    @property
    def input_rates(self) -> ca.SX:
        """Rates (nu,) conjugate to the inputs: of joints, and of thrusters along their axes, rad/s or m/s."""
        rows = self.robot.actuated_rows.tolist()
        if self.robot.actuation.is_selection:
            return self.dxi[rows]
        return ca.vertcat(self.dxi[rows], ca.mtimes(ca.DM(self.robot.actuation.thrust.T), self.v))

    @property
    def torque(self) -> ca.SX:
        """Torque (nu,) that the drives deliver, N m, joint side: the actuated rows plus joint friction."""
        if self.actuation not in ("torque", "jerk"):
            raise InputError(
                f"a term asks for torques, which a source of {self.actuation} does not have",
                "allowed: actuation 'torque' or 'jerk', or terms about motion and contact forces",
            )
        actuation, forces = self.robot.actuation, self._made_by_inputs
        if actuation.is_selection:
            inputs = forces[actuation.rows.tolist()]
        else:
            inputs = ca.mtimes(ca.DM(actuation.inverse), forces)
        return drive_torque(self.robot.drives, inputs, self.input_rates)

    def frame(self, name: str) -> FrameSymbols:
        """Symbols of the frame ``name`` of the model."""
        if name not in self._frames:
            self._frames[name] = FrameSymbols.create(name)
        return self._frames[name]

    def varies(self, expression: ca.SX) -> bool:
        """Whether an expression depends on the motion or the forces: on a symbol that is no parameter."""
        symbols = ca.vertcat(self.z, self.robot_symbols(), self.force_rates)
        return expression.numel() > 0 and bool(ca.depends_on(expression, symbols))

    def rate(self, expression: ca.SX) -> ca.SX:
        """Time derivative (n,) of an expression along the motion, at collocation points.

        It is the chain rule over ``xi`` and ``dxi`` (and so ``q`` and ``v``), and over the placements and
        velocities of frames; where jerks are the input also over ``ddxi`` (and so ``a``), torques and
        wrenches. Accelerations of frames and contacts have no rates.

        Args:
            expression: (n,), of positions and velocities.

        Raises:
            InputError: elsewhere than at a collocation point, and for an expression of other symbols.
        """
        if self.place is not Place.POINT:
            raise InputError(f"a term asks for a rate at a {self.place.value}", "allowed: collocation points")
        symbols, rates, others = self._state_rates()
        for frame in self._frames.values():
            turning = ca.mtimes(ca.skew(frame.velocity[3:]), frame.rotation)
            symbols += [ca.vec(frame.rotation), frame.position, frame.velocity]
            rates += [ca.vec(turning), frame.velocity[:3], frame.acceleration]
        others += [*self._accelerations.values(), self.force_rates]
        others += [frame.acceleration for frame in self._frames.values()]
        others += [p for p, value in zip(self._parameters, self._values, strict=True) if callable(value)]
        if ca.depends_on(expression, ca.vertcat(*others)):
            raise InputError(
                "a term asks for the rate of an acceleration, torque, wrench or reference",
                "allowed: expressions of positions, velocities and constant parameters; of ddxi, torques and"
                " wrenches with actuation 'jerk'",
            )
        forces = self._generalized_forces
        if self.given and forces is not None and ca.depends_on(expression, forces):
            raise InputError(
                "a term asks for the rate of a torque where a known wrench acts", "allowed: without wrenches"
            )
        return ca.jtimes(expression, ca.vertcat(*symbols), ca.vertcat(*rates))

    def _state_rates(self) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
        """Symbols of the inputs and of the forces that have rates, the rates, and the symbols without."""
        nv, start, order = self.coordinates.nv, self.rotations.numel(), ORDERS[self.actuation]
        scale, wrenches = self.time_scale, [*self.unknown_wrenches.values()]
        local = [self.z[start + i * nv : start + (i + 1) * nv] for i in range(order + 1)]
        rates = [self.dxi, scale * self._highest, scale**2 * self._third][:order]
        forces = [] if self._generalized_forces is None else [self._generalized_forces]
        if order < 3:
            return local[:order], rates, [local[order], *wrenches, *forces]
        if forces and self._force_rates is None:
            self._force_rates = ca.SX.sym("dtau", nv)
        rates += [rate / scale for rate in self._wrench_rates] + [self.force_rates] * len(forces)
        return [*local[:order], *wrenches, *forces], rates, [local[order], *self._wrench_rates]

    def square(self, residual: ca.SX, weight: ca.SX) -> None:
        """Record a least-squares part of a cost for Gauss-Newton, which treats its weights as constants.

        Args:
            residual: (n,).
            weight: one number or (n,), >= 0.
        """
        self._squares.append((residual, weight * ca.SX.ones(residual.numel())))

    @property
    def squares(self) -> tuple[ca.SX, ca.SX]:
        """Residuals (n,) and weights (n,) of all costs here; at a point, of the cost rate in nominal time."""
        rate = self.time_scale if self.place is Place.POINT else ca.SX(1)
        residuals = ca.vertcat(ca.SX(0, 1), *[residual for residual, _ in self._squares])
        return residuals, rate * ca.vertcat(ca.SX(0, 1), *[weight for _, weight in self._squares])

    def lever(self, contact: Contact) -> np.ndarray | None:
        """Lever (3,) of a rolling contact, from where it touches to its centre, world, m; else None."""
        return contact.lever(self._surfaces.get(contact.name))

    def contact_velocity(self, contact: Contact) -> ca.SX:
        """Twist (6,) of an active contact in world axes; for a rolling one, minus that of pure rolling."""
        twist, lever = self.frame(contact.frame).velocity, self.lever(contact)
        return twist if lever is None else without_rolling(twist, ca.DM(lever))

    def contact_acceleration(self, contact: Contact) -> ca.SX:
        """Classical acceleration of an active contact (held rows), in world or base axes.

        For a rolling contact, the acceleration of pure rolling is subtracted.

        The axes are the base link's for a free-flyer, the world's otherwise. This suffices for rows that
        vanish and is cheaper, because no orientation enters.
        """
        if contact not in self._accelerations:
            self._accelerations[contact] = ca.SX.sym(f"a_{contact.name}", len(self.held_rows(contact)))
        return self._accelerations[contact]

    @property
    def uses_dynamics(self) -> bool:
        """Whether a term has used generalised forces."""
        return self._generalized_forces is not None

    @property
    def used_accelerations(self) -> tuple[Contact, ...]:
        """Contacts whose acceleration a term has used."""
        return tuple(self._accelerations)

    @property
    def frames(self) -> Mapping[str, FrameSymbols]:
        """Frames that terms have used, in order of first use."""
        return self._frames

    def wrench_column(self) -> ca.SX:
        """Wrenches that are variables, 3 or 6 entries per contact, then known ones, in one column."""
        return ca.vertcat(*[self.wrenches[contact.name] for contact in self.contacts], self.given_wrenches)

    def dynamics_symbols(self) -> ca.SX:
        """Generalised forces and contact accelerations that terms have used, in one column."""
        forces = [self.generalized_forces] if self.uses_dynamics else []
        return ca.vertcat(*forces, *self._accelerations.values())

    def frame_symbols(self) -> ca.SX:
        """Symbols of the frames that terms have used, in one column."""
        return ca.vertcat(*[frame.stacked() for frame in self._frames.values()])

    def robot_symbols(self) -> ca.SX:
        """Symbols of the robot's functions that terms have used, in one column, without rates of forces."""
        return ca.vertcat(self.dynamics_symbols(), self.frame_symbols())

    @property
    def force_rates(self) -> ca.SX:
        """Rates (nv,) of the generalised forces; empty unless a term has asked for rates of torques."""
        return ca.SX(0, 1) if self._force_rates is None else self._force_rates

    @property
    def has_free_flyer(self) -> bool:
        """Whether base axes may be used: a single free-flyer at the root, and contacts held in all rows."""
        model = self.robot.model
        roots = [i for i in range(1, model.njoints) if model.parents[i] == 0]
        return (
            self.moving
            and all(c.transmits_all and self.held_rows(c) == c.rows for c in self.contacts)
            and all(self.slides_on(contact) is None for contact in self.contacts)
            and roots == [1]
            and self.coordinates.joints[0].kind == "freeflyer"
            and model.jointPlacements[1].isIdentity()
        )
