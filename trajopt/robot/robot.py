"""The robot: numeric model, base kind, contacts, limits and reference posture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from trajopt import _numeric
from trajopt.arguments import Positive, checked
from trajopt.dynamics.base_joint import Base, base_of, position_limits
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.dynamics.virtual_base import DEFAULT_ORDER, from_free_flyer, virtual_model
from trajopt.errors import InputError, expanded
from trajopt.kinds import ArrayShape
from trajopt.robot import building, changes
from trajopt.robot.actuators.actuation import Actuation, Thruster, least_inputs
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.joint_force import SPRING, JointForce, described_forces
from trajopt.robot.actuators.joint_limits import (
    HigherLimit,
    JointLimits,
    limits_by_row,
    require_joint_limits,
)
from trajopt.robot.actuators.mimic import MimicJoint, require_mimics
from trajopt.robot.actuators.on_robot import actuated_row_limit, drive_fields, drives_by_row, require_drives
from trajopt.robot.contact import Contact, require_frame
from trajopt.robot.coupling import following, mjcf_couplings, urdf_couplings
from trajopt.robot.data import VisualSource, package_directories
from trajopt.robot.mjcf import compile_mjcf, joint_springs, read_mjcf
from trajopt.robot.natural_units import NaturalUnits
from trajopt.robot.reading import read_urdf
from trajopt.robot.validation import (
    require_contacts,
    require_inertias,
    require_limits,
    require_reference,
    require_thrusters,
)


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A robot as problems use it. Arrays are copied and read-only.

    Args:
        name: name of the robot in tables and files.
        model: numeric Pinocchio model; its damping and friction only take effect by `with_joint_forces`.
        base: kind of the root joint. Its rows come first in v and are unactuated.
        reference: reference posture (nq,), m and rad in Pinocchio's convention, within the limits.
        velocity_limit: velocity limits (nv,), rad/s or m/s, inf where there is none.
        position_lower: lower position limits (nq,), rad or m, -inf where there is none.
        position_upper: upper position limits (nq,), rad or m, inf where there is none.
        torque_limit: largest torque or force on the joint side (nu,), N m or N, including the largest force
            of thrusters; None if nothing is limited.
        contacts: contacts with which it may touch its surroundings.
        visual: source of the meshes, for replays.
        passive: joints without an actuator, anywhere in the tree: an ankle that is a contact, a cart's pole.
        given_length: characteristic length in m; None computes it as in `length`.
        drives: a `Drive` or None for each input (nu), or None; set with `with_drives`.
        thrusters: thrusters on the base, whose forces are the last inputs; set with `with_thrusters`.
        joint_forces: springs, damping and dry friction of joints; set with `with_joint_forces`.
        mimics: mimic joints, which follow others; set with `with_mimics`.
        joint_limits: limits of acceleration, jerk and torque rate; set with `with_joint_limits`.

    Raises:
        InputError: for an unknown frame, a wrong shape, a number that is not finite, a reference outside the
            limits, or two contacts with the same name.
    """

    name: str
    model: pin.Model
    base: Base
    reference: Annotated[np.ndarray, ArrayShape((None,))]
    velocity_limit: Annotated[np.ndarray, ArrayShape((None,), infinite=True)]
    position_lower: Annotated[np.ndarray, ArrayShape((None,), infinite=True)]
    position_upper: Annotated[np.ndarray, ArrayShape((None,), infinite=True)]
    torque_limit: Annotated[np.ndarray, ArrayShape((None,), infinite=True)] | None = None
    contacts: tuple[Contact, ...] = ()
    visual: VisualSource | None = None
    passive: tuple[str, ...] = ()
    given_length: Positive | None = None
    drives: tuple[Drive | None, ...] | None = None
    thrusters: tuple[Thruster, ...] = ()
    joint_forces: tuple[JointForce, ...] = ()
    mimics: tuple[MimicJoint, ...] = ()
    joint_limits: tuple[JointLimits, ...] = ()

    def __post_init__(self) -> None:
        kind = base_of(self.model)
        if kind != self.base:
            raise InputError(
                f"robot '{self.name}' has a {kind} root joint but base={self.base!r}", f"{kind!r}"
            )
        object.__setattr__(self, "contacts", building.within_plane(self.model, self.contacts))
        require_mimics(self.name, self.model, self.mimics)
        shapes = {
            "reference": self.nq,
            "velocity_limit": self.nv,
            "position_lower": self.nq,
            "position_upper": self.nq,
            "torque_limit": self.nu,
        }
        for field, size in shapes.items():
            array = getattr(self, field)
            if array is not None and len(array) != size:
                raise InputError(
                    f"{field} of robot '{self.name}' has {len(array)} numbers", f"allowed: {size}"
                )
        position = self.position_lower, self.position_upper
        others = {
            "velocity_limit": (np.arange(self.nv), self.velocity_limit),
            "torque_limit": (self.rows_of_inputs, self.torque_limit),
        }
        require_contacts(self.name, self.model, self.contacts)
        require_thrusters(self.name, self.model, self.thrusters)
        for force in self.joint_forces:
            force.entries(self.model)
        require_inertias(self.name, self.model)
        require_limits(self.name, self.model, position, others)
        require_reference(self.name, self.model, self.reference, position)
        if self.drives is not None:
            require_drives(self.name, self.model, self.rows_of_inputs, self.drives)

    @property
    def nq(self) -> int:
        """Number of configuration coordinates."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Number of velocity coordinates."""
        return int(self.model.nv)

    @cached_property
    def unactuated_rows(self) -> np.ndarray:
        """Rows of v without an actuator: those of the base, which come first, and of passive joints."""
        return building.unactuated_rows(self.model, self.base, self.passive)

    @cached_property
    def actuated_rows(self) -> np.ndarray:
        """Rows of v with an actuator, in the order of torques."""
        return np.setdiff1d(np.arange(self.nv), self.unactuated_rows)

    @cached_property
    def actuation(self) -> Actuation:
        """The map from inputs (nu,), first joint motors and then thrusters, to generalised forces."""
        unit = NaturalUnits.of(self.model).generalized_force(self.model)
        return Actuation.of(self.model, self.actuated_rows, self.thrusters, self.mimics, unit)

    @property
    def rows_of_inputs(self) -> np.ndarray:
        """Row of v of every input (nu,), -1 for a thruster."""
        return np.append(self.actuated_rows, np.full(len(self.thrusters), -1))

    @property
    def n_unactuated(self) -> int:
        """Number of rows of v without an actuator."""
        return len(self.unactuated_rows)

    @cached_property
    def posture_search(self) -> _numeric.InverseKinematics:
        """Compiled search of `trajopt.robot.inverse_kinematics`."""
        spread = self.actuation.independent if self.mimics else np.zeros((0, 0))
        joints = [(*(joint.idx_q for joint in each.joints(self.model)), each) for each in self.mimics]
        followers = np.array([[at, leader, each.ratio, each.offset] for at, leader, each in joints])
        limits = np.array(self.position_lower, dtype=float), np.array(self.position_upper, dtype=float)
        return _numeric.InverseKinematics(self.model, *limits, spread @ spread.T, followers.reshape(-1, 4))

    @property
    def nu(self) -> int:
        """Number of inputs: joints with an actuator, and thrusters."""
        return len(self.actuated_rows) + len(self.thrusters)

    @cached_property
    def mass(self) -> float:
        """Total mass of the moving bodies in kg."""
        return mass_of(self.model)

    @cached_property
    def weight(self) -> float:
        """Scale of forces in N: mass times gravity, or times 9.81 m/s^2 without gravity."""
        return self.mass * gravity_of(self.model)

    @cached_property
    def length(self) -> float:
        """Characteristic length in m, the scale of lengths and (with gravity) of time.

        For a robot that moves on contacts, the mean height of the base above the contact frames in the
        reference posture. Otherwise (fixed base, no contacts, or a base that is not above them) the reach:
        the longest sum of link lengths from the root to any frame or centre of mass. 1 m if the model has no
        extent. ``given_length`` overrides it.
        """
        if self.given_length is not None:
            return self.given_length
        frames = [contact.frame for contact in self.contacts]
        return building.characteristic_length(self.model, self.base, frames, self.reference)

    def actuated_row_limit(self, effort: np.ndarray | None) -> np.ndarray | None:
        """Return the bound (nu,) on the actuated rows, N m, for a torque limit (nu,) of the drives."""
        return actuated_row_limit(self.drives, effort, self.velocity_limit[self.actuated_rows])

    def limited_model(self) -> pin.Model:
        """Return a copy of the model with this robot's position limits, as a solution file stores it."""
        model = pin.Model(self.model)
        model.lowerPositionLimit, model.upperPositionLimit = self.position_lower, self.position_upper
        return model

    def contact(self, name: str) -> Contact:
        """Return the contact of that name; raises `InputError` that lists the names."""
        for contact in self.contacts:
            if contact.name == name:
                return contact
        known = ", ".join(contact.name for contact in self.contacts) or "none"
        raise InputError(f"robot '{self.name}' has no contact '{name}'", f"contacts: {known}")

    @checked
    def with_locked(self, joints: Sequence[str], reference: ArrayLike | None = None) -> Robot:
        """Return this robot with ``joints`` welded at their value in ``reference`` (nq,), default its own."""
        at = self.reference if reference is None else np.asarray(reference, dtype=float)
        replace(self, reference=at)  # rejects a reference of wrong shape or outside the limits
        joints = self.locked_with(joints)
        model = building.locked_model(self.model, joints, at)
        q, v = building.joint_entries(self.model, list(model.names)[1:])
        return replace(
            self,
            model=model,
            reference=at[q],
            velocity_limit=self.velocity_limit[v],
            position_lower=self.position_lower[q],
            position_upper=self.position_upper[q],
            passive=tuple(name for name in self.passive if name not in joints),
            joint_forces=tuple(force for force in self.joint_forces if force.joint not in joints),
            mimics=tuple(mimic for mimic in self.mimics if mimic.joint not in joints),
            **self.actuators_of(v),
        )

    def locked_with(self, joints: Sequence[str]) -> list[str]:
        """These joints and their followers."""
        led = [mimic.joint for mimic in self.mimics if mimic.mimics in joints]
        return list(dict.fromkeys((*joints, *led)))

    def actuators_of(self, rows: np.ndarray) -> dict[str, Any]:
        """Return torque limits and drives of the actuated rows among ``rows`` of v, as fields of a robot."""
        actuators = np.searchsorted(self.actuated_rows, rows[np.isin(rows, self.actuated_rows)])
        actuators = np.append(actuators, np.arange(len(self.actuated_rows), self.nu))
        return {
            "torque_limit": None if self.torque_limit is None else self.torque_limit[actuators],
            "drives": None if self.drives is None else tuple(self.drives[int(row)] for row in actuators),
        }

    @checked
    def with_joint_limits(self, limits: Sequence[JointLimits]) -> Robot:
        """Return this robot with higher limits of joints. Raises InputError for an unknown joint."""
        require_joint_limits(self.model, limits)
        return replace(self, joint_limits=tuple(limits))

    def joint_limit(self, kind: HigherLimit) -> np.ndarray:
        """Limits (nv,) of acceleration, jerk or torque rate, see `JointLimits`, inf where there is none."""
        return limits_by_row(self.model, self.joint_limits, kind)

    @checked
    def with_drives(self, drives: Mapping[str, Drive | None] | Sequence[Drive | None]) -> Robot:
        """Return this robot with drives: by joint name, or one (or None) for each input (nu).

        The drive replaces what the model says of its joint. The reflected rotor inertia n^2 I_r, unless it
        is 0, replaces the armature (the same quantity, from another source). |n| torque_limit, if finite,
        replaces the torque limit. The velocity limit is lowered to no_load_speed / |n|, beyond which the
        induced voltage exceeds the supply.

        Raises `InputError` for a joint that is unknown or not actuated, `UnsupportedJointError` for one
        of several degrees of freedom.
        """
        rows = self.rows_of_inputs
        chosen = drives_by_row(self.name, self.model, rows, self.drives or (None,) * self.nu, drives)
        return replace(self, **drive_fields(self.model, rows, self.torque_limit, self.velocity_limit, chosen))

    @checked
    def with_thrusters(self, thrusters: Sequence[Thruster]) -> Robot:
        """Return this robot with thrusters on its base, in place of those it has.

        Raises `InputError` for a frame that is unknown or not on the base, a base that is not "freeflyer" or
        "planar", or two thrusters of the same name.
        """
        return replace(self, **changes.thrusters(self, thrusters))

    @checked
    def with_joint_forces(self, forces: Sequence[JointForce] | None = None) -> Robot:
        """Return this robot with springs, damping and dry friction at joints, in place of those it has.

        Series springs are kept unless their joints, ``JOINT_spring``, are among those given.

        Args:
            forces: joint forces; default the damping, dry friction and (MJCF only) springs of its file.

        Raises:
            InputError: for an unknown joint, or one of several degrees of freedom.
        """
        if forces is None:
            is_mjcf = self.visual is not None and self.visual.is_mjcf
            springs = joint_springs(compile_mjcf(self.visual.urdf)) if self.visual and is_mjcf else {}
            forces = described_forces(self.model, springs)
        named = {force.joint for force in forces}
        kept = (f for f in self.joint_forces if f.joint.endswith(SPRING) and f.joint not in named)
        return replace(self, joint_forces=(*forces, *kept))

    @checked
    def with_series_springs(self, stiffness: Mapping[str, float]) -> Robot:
        """Return this robot with series elastic actuators: springs between the gear and the link of joints.

        A passive joint ``JOINT_spring`` is added behind each joint. It carries the link, and its position is
        the spring's deflection. The joint itself becomes the gear's side: it keeps its motor and its limits,
        and its inertia is the armature.

        Args:
            stiffness: N m/rad or N/m, by the joint's name.

        Raises:
            InputError: for a joint that is unknown, has no armature or several degrees of freedom.
        """
        return replace(self, **changes.series_springs(self, stiffness))

    @checked
    def with_mimics(self, mimics: Sequence[MimicJoint], driven: Sequence[str] = ()) -> Robot:
        """Return this robot with mimic joints, which follow others, in place of those it has.

        The reference is changed to satisfy the rules, and the limits of either joint of a pair hold for both.

        Args:
            mimics: followers and their leaders.
            driven: followers that keep a motor of their own; the others become passive.

        Raises:
            InputError: for joints that are unknown, have several coordinates, or follow a follower.
        """
        return replace(self, **changes.mimics(self, mimics, driven))

    def with_rolling_contacts(self) -> Robot:
        """Return this robot with every contact that has a radius rolling, see `Contact`.

        Raises `InputError` if no contact has a radius.
        """
        if not any(contact.radius for contact in self.contacts):
            raise InputError(f"robot '{self.name}' has no contact that could roll", "contacts with a radius")
        return replace(self, contacts=tuple(replace(c, rolling=c.radius > 0) for c in self.contacts))

    def least_torque(self, limit: np.ndarray) -> np.ndarray:
        """Lower bounds (nu,) of the inputs for upper bounds ``limit`` (nu,): ``-limit`` for joints."""
        return least_inputs(limit, self.thrusters)

    def with_virtual_base(self, order: str = DEFAULT_ORDER) -> Robot:
        """Return this free-flyer robot with six virtual joints as its base: x, y, z, then three angles.

        Everything else is kept: inertias, frames, contacts, limits, drives and the reference.

        Args:
            order: order of the angles' axes, "ZYX" for yaw, pitch, roll; one of `virtual_base.ORDERS`.

        Raises:
            InputError: for another base or an unknown order.
        """
        if self.base != "freeflyer":
            raise InputError(f"robot '{self.name}' has base={self.base!r}", "'freeflyer'")
        still = np.zeros(self.nv)
        return replace(
            self,
            model=virtual_model(self.model, order),
            base="virtual",
            reference=from_free_flyer(order, self.reference, still, still)[0],
            position_lower=np.concatenate([np.full(6, -np.inf), self.position_lower[7:]]),
            position_upper=np.concatenate([np.full(6, np.inf), self.position_upper[7:]]),
        )

    @classmethod
    @checked
    def from_urdf(
        cls,
        path: str | Path,
        *,
        base: Base = "freeflyer",
        contacts: Sequence[str | Contact] = (),
        reference: ArrayLike | Mapping[str, float] | None = None,
        locked: Sequence[str] = (),
        name: str | None = None,
        package_dirs: Sequence[str | Path] | None = None,
        passive: Sequence[str] = (),
        frames: Mapping[str, Any] | None = None,
    ) -> Robot:
        """Build a robot from a URDF file.

        Args:
            path: path of the file.
            base: "freeflyer", "virtual" (six joints: x, y, z, yaw, pitch, roll; for another order of the
                angles see `with_virtual_base`), "planar" (in the world's x-z plane) or "fixed".
            contacts: frame names (point contacts) or `Contact` objects.
            reference: see `building.reference_posture`; in terms of the joints before locking.
            locked: names of joints to weld at the reference.
            name: name of the robot; default the one in the file.
            package_dirs: directories of ``package://`` paths of meshes; default the folders above the file.
            passive: names of joints without an actuator.
            frames: frames to add, see `building.with_frames`.

        Raises:
            InputError: for a missing or malformed file, an unlocked mimic joint that is continuous or whose
                leader does not move, and as `Robot`.
        """
        model = read_urdf(path, base)
        mimics = following(path, urdf_couplings(path), locked)
        source = expanded(path).absolute()
        given = None if package_dirs is None else tuple(Path(entry).absolute() for entry in package_dirs)
        directories = package_directories(source) if given is None else given
        robot = cls.from_model(
            model,
            base=base,
            contacts=contacts,
            reference=reference,
            locked=() if mimics else locked,
            name=name or model.name,
            visual=VisualSource(urdf=source, package_dirs=directories),
            passive=passive,
            frames=frames,
        )
        return robot.with_mimics(list(mimics)).with_locked(locked) if mimics else robot

    @classmethod
    @checked
    def from_mjcf(
        cls,
        path: str | Path,
        *,
        base: Base | None = None,
        reference: ArrayLike | Mapping[str, float] | None = None,
        locked: Sequence[str] = (),
        passive: Sequence[str] | None = None,
        **options: Any,
    ) -> Robot:
        """Build a robot from an MJCF file as MuJoCo compiles it; arguments and ``options`` as in `from_urdf`.

        The default base is that of the file. The default reference is the keyframe "home", or else the first
        one, if it is within the limits, or else the pose in which the file has its bodies; with contacts the
        base is moved until they touch the ground. A mapping changes joints of that reference. By default
        joints without an actuator are passive, if others have one. Contacts name bodies, sites and colliding
        balls.

        Raises `InputError` for a missing or malformed file, a base that contradicts it, unlocked joints that
        depend on others nonlinearly or in loops, several free joints, and if MuJoCo is not installed.
        """
        compiled = compile_mjcf(path)
        mimics = following(path, mjcf_couplings(compiled), locked)
        read = read_mjcf(path, compiled, base)
        posture = reference
        if reference is None or isinstance(reference, Mapping):
            posture = building.named_posture(read.model, reference or {}, read.start)
        idle = read.passive if passive is None else passive
        robot = cls.from_model(
            read.model,
            base=base,
            reference=posture,
            locked=() if mimics else locked,
            passive=[joint for joint in idle if mimics or joint not in locked],
            **{"visual": VisualSource(urdf=expanded(path).absolute()), **options},
        )
        if mimics:
            driven = [mimic.joint for mimic, has_motor in mimics.items() if has_motor]
            robot = robot.with_mimics(list(mimics), driven).with_locked(locked)
        if read.thrusters:
            robot = robot.with_thrusters(read.thrusters)
        if posture is reference:
            return robot
        standing = building.put_on_ground(robot.model, robot.base, robot.contacts, robot.reference)
        return replace(robot, reference=standing)

    @classmethod
    @checked
    def from_model(
        cls,
        model: pin.Model,
        *,
        base: Base | None = None,
        contacts: Sequence[str | Contact] = (),
        reference: ArrayLike | Mapping[str, float] | None = None,
        locked: Sequence[str] = (),
        name: str | None = None,
        visual: VisualSource | None = None,
        passive: Sequence[str] = (),
        frames: Mapping[str, Any] | None = None,
    ) -> Robot:
        """Build a robot from a numeric Pinocchio model and its limits; arguments as in `from_urdf`."""
        model = building.with_frames(model, frames or {})
        kind = base if base is not None else base_of(model)
        named = tuple(entry if isinstance(entry, Contact) else Contact(frame=entry) for entry in contacts)
        for contact in named:
            require_frame(model, contact.frame, f"contact '{contact.name}'")
        lower, upper = position_limits(model)
        robot = cls(
            name=name or model.name or "robot",
            model=model,
            base=kind,
            contacts=named,
            reference=building.reference_posture(model, kind, named, reference),
            torque_limit=building.torque_limit_of(model, kind, passive),
            velocity_limit=building.velocity_limit_of(model, kind),
            position_lower=lower,
            position_upper=upper,
            visual=visual,
            passive=tuple(passive),
        )
        return robot.with_locked(locked) if locked else robot
