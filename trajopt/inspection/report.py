"""A robot in figures: joints, limits, contacts, torques needed to stand, and likely mistakes."""

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trajopt.collision.description import RobotShapes, robot_shapes
from trajopt.collision.shapes import KINDS
from trajopt.dynamics.base_joint import BASE_ROWS
from trajopt.dynamics.model_quantities import joints_of_rows
from trajopt.errors import InputError
from trajopt.inspection.faults import find_faults, listed
from trajopt.inspection.standing import StandingPosture, standing_posture
from trajopt.robot.building import planar_root
from trajopt.robot.coupling import couplings_of
from trajopt.robot.geometry import described_geometry, mesh_vertices
from trajopt.robot.kinematics import contact_positions
from trajopt.robot.mjcf import body_names, compile_mjcf, joint_names
from trajopt.robot.mjcf_actuators import BALL, actuation_of
from trajopt.robot.reading import require_xml
from trajopt.robot.robot import Robot

# Number of pairs and files that the text names for each reason; the JSON has all of them.
NAMED_PAIRS = 3


@dataclass(frozen=True, kw_only=True)
class ShapeFacts:
    """Shapes of a robot's links.

    Args:
        kinds: number of shapes of each kind.
        pairs: number of pairs that must not touch.
        left_out: other pairs by the reason for which they are not judged.
        missing: shapes that could not be read.
        above_ground: whether the ground is an obstacle: not if links of a fixed base reach below it.
    """

    kinds: dict[str, int]
    pairs: int
    left_out: dict[str, tuple[tuple[str, str], ...]]
    missing: tuple[str, ...]
    above_ground: bool

    def lines(self) -> list[str]:
        """The facts as lines of text."""
        if not self.kinds:
            return ["none: the size of its links is not known", *self._missing()]
        counts = [f"{number} {_plural(kind, number)}" for kind, number in self.kinds.items()]
        lines = [f"{', '.join(counts)}; {self.pairs} {_plural('pair', self.pairs)} must not touch"]
        for reason, pairs in self.left_out.items():
            named = ", ".join(f"{first} and {second}" for first, second in pairs[:NAMED_PAIRS])
            more = ", ..." if len(pairs) > NAMED_PAIRS else ""
            lines.append(f"{len(pairs)} {_plural('pair', len(pairs))} not judged, {reason}: {named}{more}")
        if not self.above_ground:
            lines.append("links reach below the base's ground in the reference posture: it is not judged")
        return lines + self._missing()

    def _missing(self) -> list[str]:
        if not self.missing:
            return []
        more = ", ..." if len(self.missing) > NAMED_PAIRS else ""
        return [f"{len(self.missing)} shapes cannot be read: {'; '.join(self.missing[:NAMED_PAIRS])}{more}"]


def shape_facts(robot: Robot) -> ShapeFacts:
    """Return the facts of the shapes found by `robot_shapes`."""
    shapes = robot_shapes(robot)
    counts = Counter(shape.kind for shape in shapes.shapes)
    return ShapeFacts(
        kinds={kind: counts[kind] for kind in KINDS if counts[kind]},
        pairs=len(shapes.pairs),
        left_out=_by_reason(shapes),
        missing=shapes.missing,
        above_ground=shapes.above_ground,
    )


def _by_reason(shapes: RobotShapes) -> dict[str, tuple[tuple[str, str], ...]]:
    """Pairs by reason; the depths of overlaps are left out."""
    reasons: dict[str, list[tuple[str, str]]] = {}
    for pair, reason in shapes.left_out.items():
        what = "overlap in the reference posture" if "reference" in reason else reason
        reasons.setdefault(what, []).append(pair)
    return {reason: tuple(pairs) for reason, pairs in reasons.items()}


def _plural(word: str, number: int) -> str:
    ending = "es" if word.endswith("x") else "s"
    return word if number == 1 else word + ending


@dataclass(frozen=True, kw_only=True)
class JointFacts:
    """A joint behind the base, in rad, N m and rad/s, or in m, N and m/s if it is ``straight``.

    reference: position in the reference posture. lower, upper: limits, infinite without them. torque: needed
    to hold that posture at rest. reference and torque are NaN with several degrees of freedom, torque also
    without an actuator.
    """

    name: str
    kind: str
    straight: bool
    reference: float
    lower: float
    upper: float
    velocity: float
    effort: float
    torque: float


@dataclass(frozen=True, kw_only=True)
class ContactFacts:
    """A contact; ``position`` is that of its frame (3,) in the reference posture, world, m.

    radius: radius of the ball of a point contact, m. load: vertical force at rest, N.
    """

    name: str
    frame: str
    kind: str
    radius: float
    position: tuple[float, float, float]
    load: float


@dataclass(frozen=True, kw_only=True)
class RobotReport:
    """Result of `robot_report`, in SI units; ``notes`` are useful facts, ``warnings`` are likely mistakes."""

    name: str
    base: str
    nq: int
    nv: int
    nu: int
    mass: float
    weight: float
    length: float
    joints: tuple[JointFacts, ...]
    contacts: tuple[ContactFacts, ...]
    shapes: ShapeFacts
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form."""
        return asdict(self)

    def table(self) -> str:
        """Return the report as text."""
        lines = [
            f"{self.name}: {self.base} base, {self.mass:.4g} kg ({self.weight:.4g} N),"
            f" length {self.length:.3g} m, nq {self.nq}, nv {self.nv}, {self.nu} actuated"
        ]
        lines += _columns(_JOINT_TITLES, [_joint_row(joint) for joint in self.joints])
        if self.contacts:
            lines += _columns(_CONTACT_TITLES, [_contact_row(contact) for contact in self.contacts])
        lines += [f"  shapes     {text}" for text in self.shapes.lines()]
        lines += [f"  note       {text}" for text in self.notes]
        lines += [f"  warning    {text}" for text in self.warnings]
        return "\n".join(lines)


_JOINT_TITLES = ("joint", "kind", "reference", "position limits", "velocity", "effort", "at rest")
_CONTACT_TITLES = ("contact", "frame", "kind", "radius", "x", "y", "z", "load")


def robot_report(robot: Robot) -> RobotReport:
    """Return figures, notes and warnings of a robot, computed with Pinocchio; no problem is solved."""
    rest = standing_posture(robot)
    loads = dict(zip(rest.feet, rest.load, strict=True)) if len(rest.load) == len(rest.feet) else {}
    places = contact_positions(robot, robot.reference)
    return RobotReport(
        name=robot.name,
        base=robot.base,
        nq=robot.nq,
        nv=robot.nv,
        nu=robot.nu,
        mass=robot.mass,
        weight=robot.weight,
        length=robot.length,
        joints=_joints(robot, rest.effort),
        contacts=tuple(
            ContactFacts(
                name=contact.name,
                frame=contact.frame,
                kind=contact.kind,
                radius=contact.radius,
                position=tuple(places[contact.name].tolist()),
                load=float(loads.get(contact.name, 0.0)),
            )
            for contact in robot.contacts
        ),
        shapes=shape_facts(robot),
        notes=_notes(robot, rest),
        warnings=find_faults(robot, rest),
    )


def _joints(robot: Robot, torque: np.ndarray) -> tuple[JointFacts, ...]:
    facts = []
    effort = np.full(robot.nu, np.inf) if robot.torque_limit is None else robot.torque_limit
    for joint in list(robot.model.joints)[1:]:
        if joint.idx_v < BASE_ROWS[robot.base]:
            continue
        kind = joint.shortname().removeprefix("JointModel")
        single, actuated = joint.nv == 1, joint.idx_v in robot.actuated_rows
        q = robot.reference[joint.idx_q : joint.idx_q + joint.nq]
        angle = float(q[0]) if joint.nq == 1 else float(np.arctan2(q[1], q[0])) if joint.nq == 2 else np.nan
        bounded = joint.nq == joint.nv == 1
        row = np.searchsorted(robot.actuated_rows, joint.idx_v)
        facts.append(
            JointFacts(
                name=robot.model.names[joint.id],
                kind=kind,
                straight=kind.startswith("P") and not kind.startswith("Planar"),
                reference=angle if single else np.nan,
                lower=float(robot.position_lower[joint.idx_q]) if bounded else -np.inf,
                upper=float(robot.position_upper[joint.idx_q]) if bounded else np.inf,
                velocity=float(robot.velocity_limit[joint.idx_v]),
                effort=float(effort[row]) if actuated else np.inf,
                torque=float(torque[row]) if actuated and single else np.nan,
            )
        )
    return tuple(facts)


def _notes(robot: Robot, rest: StandingPosture) -> tuple[str, ...]:
    notes = []
    if robot.base != "fixed" and robot.contacts:
        lifted = [contact.name for contact in robot.contacts if contact.name not in rest.feet]
        if lifted:
            notes.append(f"off the ground in the reference posture: {listed(lifted)}")
    if root := planar_root(robot.model):
        notes.append(f"planar root, kept as joints on a fixed base: {root} (base='planar' is x, z, about -y)")
    owners = joints_of_rows(robot.model)
    for what, values in (
        ("damping", robot.model.damping),
        ("dry friction", robot.model.upperDryFrictionLimit),
    ):
        names = list(dict.fromkeys(owners[row] for row in np.flatnonzero(values)))
        if names and not robot.joint_forces:
            notes.append(f"{what} of the file counts with Robot.with_joint_forces() alone: {listed(names)}")
    if robot.mimics:
        notes.append("followed: " + listed([f"'{one.joint}' after '{one.mimics}'" for one in robot.mimics]))
    if robot.thrusters:
        notes.append("thrusters: " + listed([thruster.name for thruster in robot.thrusters]))
    try:
        unused = unused_parts(robot)
    except InputError:  # said below, of shapes
        unused = {}
    notes += [f"not part of the dynamics: {what}: {listed(names)}" for what, names in unused.items() if names]
    if robot.visual is None:
        notes.append("no description with meshes: a replay draws a skeleton")
        return tuple(notes)
    try:
        drawn = described_geometry(robot.visual, robot.model, "visual")
    except InputError as error:
        return (*notes, f"a replay draws a skeleton: {error}")
    lost = [f"no mesh file {file}" for file in drawn.missing.values()]
    for entry in drawn.geometry.geometryObjects:
        try:
            if entry.name in drawn.meshes:
                mesh_vertices(entry.meshPath, entry.meshScale)
        except InputError as error:
            lost.append(error.what)
    count = drawn.geometry.ngeoms - len(lost) + len(drawn.missing)
    notes.append(f"{count} shapes to draw" if count else "nothing to draw: a replay draws a skeleton")
    return (*notes, f"a replay draws not all: {listed(list(dict.fromkeys(lost)))}") if lost else tuple(notes)


def _joint_row(joint: JointFacts) -> tuple[str, ...]:
    length, rate, force = ("m", "m/s", "N") if joint.straight else ("rad", "rad/s", "N m")
    limits = f"{joint.lower:.3g} to {joint.upper:.3g} {length}"
    return (
        joint.name,
        joint.kind,
        "-" if np.isnan(joint.reference) else f"{round(joint.reference, 3) + 0.0:.3f}",
        limits if np.isfinite([joint.lower, joint.upper]).any() else "none",
        f"{joint.velocity:.3g} {rate}" if np.isfinite(joint.velocity) else "none",
        f"{joint.effort:.3g} {force}" if np.isfinite(joint.effort) else "none",
        _torque(joint, force),
    )


def _torque(joint: JointFacts, unit: str) -> str:
    if np.isnan(joint.torque):
        return "-"
    share = abs(joint.torque) / joint.effort if joint.effort else np.inf
    part = f" ({100 * share:.0f} %)" if np.isfinite(joint.effort) and np.isfinite(share) else ""
    return f"{round(joint.torque, 2) + 0.0:.2f} {unit}{part}"


def _contact_row(contact: ContactFacts) -> tuple[str, ...]:
    # A height may round to negative zero.
    place = (f"{round(value, 3) + 0.0:.3f}" for value in contact.position)
    radius = f"{1e3 * contact.radius:.4g} mm" if contact.radius else "-"
    return (contact.name, contact.frame, contact.kind, radius, *place, f"{contact.load:.1f} N")


def _columns(titles: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    return [
        "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (titles, *rows)
    ]


def unused_parts(robot: Robot) -> dict[str, list[str]]:
    """Names of parts that the dynamics leave out, by kind. Raises `InputError` for an unreadable file."""
    source, moving, found = robot.visual, set(robot.model.names), dict[str, list[str]]()
    if source is None or not source.urdf.is_file():
        return {}
    for coupling in couplings_of(source):
        if not moving.intersection(coupling.needed):
            found.setdefault("couplings of joints, which are locked", []).append(coupling.what)
    if source.is_mjcf:
        return found | _of_mjcf(compile_mjcf(source.urdf), {thruster.name for thruster in robot.thrusters})
    root = require_xml(source.urdf)
    guarded = [each for each in root.findall("joint") if each.find("safety_controller") is not None]
    parts = {"transmissions": root.findall("transmission"), "safety controllers": guarded}
    return found | {what: [each.get("name", "") for each in these] for what, these in parts.items()}


def _of_mjcf(compiled: Any, thrusters: set[str]) -> dict[str, list[str]]:
    actuation = actuation_of(compiled)
    idle = [thruster.name for thruster in actuation.thrusters if thruster.name not in thrusters]
    joints, bodies = np.array(joint_names(compiled)), np.array(body_names(compiled))
    limited = (compiled.jnt_type == BALL) & compiled.jnt_limited.astype(bool)
    return {
        "actuators other than of hinges, slides and thrusters on the base": [*actuation.others, *idle],
        "tendons": [compiled.tendon(index).name or f"tendon{index}" for index in range(compiled.ntendon)],
        "flexes": [f"flex{index}" for index in range(compiled.nflex)],
        "springs of joints": joints[compiled.jnt_stiffness != 0].tolist(),
        "limits of ball joints": joints[limited].tolist(),
        "gravity compensation of bodies": bodies[compiled.body_gravcomp != 0].tolist(),
        "fluid forces": [n for n in ("density", "viscosity", "wind") if np.any(getattr(compiled.opt, n))],
    }
