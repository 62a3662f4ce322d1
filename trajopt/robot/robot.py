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

from trajopt.arguments import checked
from trajopt.dynamics.base_joint import Base, base_of, position_limits
from trajopt.dynamics.model_quantities import gravity_of, mass_of
from trajopt.dynamics.virtual_base import DEFAULT_ORDER, from_free_flyer, virtual_model
from trajopt.errors import InputError, expanded
from trajopt.kinds import ArrayShape
from trajopt.robot import building
from trajopt.robot.actuators.drive import Drive
from trajopt.robot.actuators.on_robot import actuated_row_limit, drive_fields, drives_by_row, require_drives
from trajopt.robot.contact import Contact, require_frame
from trajopt.robot.coupling import mjcf_couplings, require_independent, urdf_couplings
from trajopt.robot.data import VisualSource, package_directories
from trajopt.robot.mjcf import compile_mjcf, read_mjcf
from trajopt.robot.reading import read_urdf
from trajopt.robot.validation import require_contacts, require_inertias, require_limits, require_reference


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A robot as problems use it. Arrays are copied and read-only.

    Args:
        name: word for tables and files.
        model: numeric Pinocchio model; joint damping and friction in it are not part of the dynamics.
        base: kind of the root joint. The base rows come first in v and are unactuated.
        reference: posture (nq,), m and rad in Pinocchio's convention, within the limits.
        velocity_limit: (nv,), rad/s or m/s, inf where there is none.
        position_lower: least positions (nq,), rad or m, -inf where there is no limit.
        position_upper: largest positions (nq,), rad or m, inf where there is no limit.
        torque_limit: torque or force on the joint side (nu,), N m or N; None without any limit.
        contacts: where it may touch its surroundings.
        visual: where the meshes are, for a replay.
        passive: joints without actuator (an ankle that is a contact, the shoulder of an acrobot), behind
            the base rows and before every other joint.
        given_length: characteristic length in m; None takes the one that `length` measures.
        drives: a `Drive` or None for each actuated row (nu), or None; set with `with_drives`.

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
    given_length: float | None = None
    drives: tuple[Drive | None, ...] | None = None

    def __post_init__(self) -> None:
        kind = base_of(self.model)
        if kind != self.base:
            raise InputError(
                f"robot '{self.name}' has a {kind} root joint but base={self.base!r}", f"{kind!r}"
            )
        object.__setattr__(self, "contacts", building.within_plane(self.model, self.contacts))
        building.count_unactuated_rows(self.model, self.base, self.passive)
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
            "velocity_limit": (range(self.nv), self.velocity_limit),
            "torque_limit": (range(self.n_unactuated, self.nv), self.torque_limit),
        }
        require_contacts(self.name, self.model, self.contacts)
        require_inertias(self.name, self.model)
        require_limits(self.name, self.model, self.given_length, position, others)
        require_reference(self.name, self.model, self.reference, position)
        if self.drives is not None:
            require_drives(self.name, self.model, self.nu, self.drives)

    @property
    def nq(self) -> int:
        """Number of configuration coordinates."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Number of velocity coordinates."""
        return int(self.model.nv)

    @cached_property
    def n_unactuated(self) -> int:
        """Number of rows without actuator, which come first: the base's 6, 3 or 0, then passive joints."""
        return building.count_unactuated_rows(self.model, self.base, self.passive)

    @cached_property
    def scalar_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of q, and of v, of the joints with one coordinate."""
        joints = [joint for joint in self.model.joints if joint.nq == joint.nv == 1]
        rows = np.array([[joint.idx_q, joint.idx_v] for joint in joints], dtype=int).reshape(-1, 2)
        return rows[:, 0], rows[:, 1]

    @property
    def nu(self) -> int:
        """Number of actuated rows."""
        return self.nv - self.n_unactuated

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

        The mean height of the base above the contact frames in the reference posture, for a
        robot that moves on contacts. Otherwise (fixed base, no contacts, or a base that is not above them)
        the reach: the longest sum of link lengths from the root to any frame or centre of mass. 1 m if the
        model has no extent. ``given_length`` overrides it.
        """
        if self.given_length is not None:
            return self.given_length
        frames = [contact.frame for contact in self.contacts]
        return building.characteristic_length(self.model, self.base, frames, self.reference)

    def actuated_row_limit(self, effort: np.ndarray | None) -> np.ndarray | None:
        """Return the bound (nu,) on the actuated rows, N m, of an torque limit (nu,) of the drives."""
        return actuated_row_limit(self.drives, effort, self.velocity_limit[self.n_unactuated :])

    def limited_model(self) -> pin.Model:
        """Return a copy of the model that carries this robot's limits, as a solution file stores it."""
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
            **self.actuators_of(v),
        )

    def actuators_of(self, rows: np.ndarray) -> dict[str, Any]:
        """Return torque limits and drives of the actuated ones of ``rows`` of v, as fields of a robot."""
        actuators = rows[rows >= self.n_unactuated] - self.n_unactuated
        return {
            "torque_limit": None if self.torque_limit is None else self.torque_limit[actuators],
            "drives": None if self.drives is None else tuple(self.drives[int(row)] for row in actuators),
        }

    @checked
    def with_drives(self, drives: Mapping[str, Drive | None] | Sequence[Drive | None]) -> Robot:
        """Return this robot with drives: by joint name, or one (or None) for each actuated row (nu).

        Limits and inertias are stated once, by the drive: the reflected rotor inertia n^2 I_r replaces the
        model's armature of that joint (which is the same quantity, from another source), unless it is 0;
        |n| torque_limit, if finite, replaces its torque limit; its velocity limit is lowered to
        no_load_speed / |n|, beyond which the induced voltage exceeds the supply.

        Raises `InputError` for a joint that is unknown or not actuated, `UnsupportedJointError` for one
        of several degrees of freedom.
        """
        chosen = drives_by_row(self.name, self.model, self.drives or (None,) * self.nu, drives)
        return replace(self, **drive_fields(self.model, self.torque_limit, self.velocity_limit, chosen))

    def with_virtual_base(self, order: str = DEFAULT_ORDER) -> Robot:
        """Return this free-flyer robot with six virtual joints as its base: x, y, z, then three angles.

        All else is kept: inertias, frames, contacts, limits, drives and the reference.

        Args:
            order: of the angles' axes, "ZYX" for yaw, pitch, roll; one of `virtual_base.ORDERS`.

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
    ) -> Robot:
        """Build a robot from a URDF file.

        Args:
            path: of the file.
            base: "freeflyer", "virtual" (six joints: x, y, z, yaw, pitch, roll; for another order of the
                angles see `with_virtual_base`), "planar" (in the world's x-z plane) or "fixed".
            contacts: frame names (point contacts) or `Contact` objects.
            reference: see `building.reference_posture`; in terms of the joints before locking.
            locked: names of joints to weld at the reference.
            name: of the robot; default the one in the file.
            package_dirs: where ``package://`` paths of meshes start; default the folders above the file.
            passive: names of joints without actuator, which must come first.

        Raises:
            InputError: for a missing or malformed file, a joint that mimics another and is not locked, and
                as `Robot`.
        """
        model = read_urdf(path, base)
        require_independent(path, urdf_couplings(path), locked)
        source = expanded(path).absolute()
        given = None if package_dirs is None else tuple(Path(entry).absolute() for entry in package_dirs)
        directories = package_directories(source) if given is None else given
        return cls.from_model(
            model,
            base=base,
            contacts=contacts,
            reference=reference,
            locked=locked,
            name=name or model.name,
            visual=VisualSource(urdf=source, package_dirs=directories),
            passive=passive,
        )

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

        The default base is the file's, the default reference its keyframe "home", or else the first, if it is
        within the limits; contacts put its base on the ground, and joints that a mapping does not name are
        those of it. By default joints without actuator are passive, if others have one. Contacts name bodies,
        sites and colliding balls.

        Raises `InputError` for a missing or malformed file, a base that contradicts it, joints that are not
        independent and not locked, several free joints, and where MuJoCo is not installed.
        """
        compiled = compile_mjcf(path)
        require_independent(path, mjcf_couplings(compiled), locked)
        read = read_mjcf(path, compiled, base)
        posture = {**read.joints, **reference} if isinstance(reference, Mapping) else reference
        idle = read.passive if passive is None else passive
        robot = cls.from_model(
            read.model,
            base=base,
            reference=read.home if posture is None else posture,
            locked=locked,
            passive=[joint for joint in idle if joint not in locked],
            **{"visual": VisualSource(urdf=expanded(path).absolute()), **options},
        )
        if reference is not None or read.home is None:
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
    ) -> Robot:
        """Build a robot from a numeric Pinocchio model and its limits; arguments as in `from_urdf`."""
        kind = base if base is not None else base_of(model)
        named = tuple(entry if isinstance(entry, Contact) else Contact(frame=entry) for entry in contacts)
        for contact in named:
            require_frame(model, contact.frame, f"contact '{contact.name}'")
        lower, upper = position_limits(model)
        robot = cls(
            name=name or model.name or "robot",
            model=pin.Model(model),
            base=kind,
            contacts=named,
            reference=building.reference_posture(model, kind, named, reference),
            torque_limit=building.torque_limit_of(
                model, building.count_unactuated_rows(model, kind, passive)
            ),
            velocity_limit=building.velocity_limit_of(model, kind),
            position_lower=lower,
            position_upper=upper,
            visual=visual,
            passive=tuple(passive),
        )
        return robot.with_locked(locked) if locked else robot
