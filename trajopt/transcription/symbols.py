"""Names of the subjects of a term's expression, inferred from the symbols in it.

A term is a small expression over the symbols of its context. For any term, the symbols in a row identify its
subject: one joint's torque, one contact's force, the height of one frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from trajopt.dynamics.manifold import Coordinates
from trajopt.robot.robot import Robot
from trajopt.terms.context import Context
from trajopt.terms.context_symbols import Place
from trajopt.transcription.timeline import NodeLayout

AXES = ("x", "y", "z", "rx", "ry", "rz")
QUATERNION = ("x", "y", "z", "w")
# A row with more owners than this is named by its number alone.
MOST_OWNERS = 4


@dataclass(frozen=True, kw_only=True, order=True)
class Label:
    """Name of a variable or symbol.

    Args:
        owner: a joint, the base, a contact, a frame or a phase.
        kind: kind of quantity, such as position, rate, acceleration, force, impulse, torque or time scale.
        quantity: the owner's quantity in words, with its axis, for example "force x".
    """

    owner: str
    kind: str
    quantity: str

    def __str__(self) -> str:
        return f"{self.owner} {self.quantity}"


def coordinate_owners(robot: Robot, coordinates: Coordinates) -> list[tuple[str, str]]:
    """Owner and axis of each local coordinate (nv,); the axis is empty for joints of one coordinate."""
    owners: list[tuple[str, str]] = []
    for joint in coordinates.joints:
        size = joint.v.stop - joint.v.start
        base = robot.base != "fixed" and joint is coordinates.joints[0] and size > 1
        owner = "base" if base else joint.name
        axes = {
            "freeflyer": ("x", "y", "z", "turn about x", "turn about y", "turn about z"),
            "planar": ("x", "y", "turn"),
            "spherical": ("turn about x", "turn about y", "turn about z"),
        }.get(joint.kind, ("",) if size == 1 else AXES[:size])
        owners += [(owner, axis) for axis in axes]
    return owners


def coordinate_labels(robot: Robot, coordinates: Coordinates, kind: str) -> list[Label]:
    """Labels (nv,) of the local coordinates' positions, rates, accelerations, jumps or torques."""
    return [
        Label(owner=owner, kind=kind, quantity=f"{axis} {kind}".strip())
        for owner, axis in coordinate_owners(robot, coordinates)
    ]


def rotation_labels(robot: Robot, coordinates: Coordinates) -> list[Label]:
    """Labels of the quaternions' entries, four per rotation."""
    owners = coordinate_owners(robot, coordinates)
    first = coordinates.rotation_index[::3]
    return [
        Label(owner=owners[int(index)][0], kind="position", quantity=f"quaternion {entry}")
        for index in first
        for entry in QUATERNION
    ]


def wrench_labels(name: str, rows: Sequence[int], linear: str, angular: str) -> list[Label]:
    """Labels of these rows of a contact's wrench or motion."""
    return [
        Label(
            owner=name,
            kind=linear if row < 3 else angular,
            quantity=f"{linear if row < 3 else angular} {AXES[row % 3]}",
        )
        for row in rows
    ]


def node_labels(form: NodeLayout, free_phases: Sequence[str]) -> list[Label]:
    """Labels of a node's entries; ``free_phases`` names the phases of free duration."""
    positions = coordinate_labels(form.robot, form.coordinates, "position")
    rates = coordinate_labels(form.robot, form.coordinates, "rate")
    additive = [positions[int(index)] for index in form.coordinates.additive_index]
    durations = [Label(owner=f"phase {name}", kind="time scale", quantity="duration") for name in free_phases]
    rotations = rotation_labels(form.robot, form.coordinates)
    second = coordinate_labels(form.robot, form.coordinates, "acceleration")
    return [*rotations, *additive, *[*rates, *second][: (form.order - 1) * len(rates)], *durations]


def input_labels(context: Context, form: NodeLayout, free_phases: Sequence[str]) -> list[Label]:
    """Labels of a context's inputs z, in their order."""
    if context.place is Place.NODE:
        return node_labels(form, free_phases)
    robot, coordinates = form.robot, context.coordinates
    impact = context.place is Place.IMPACT
    labels = rotation_labels(robot, coordinates)
    highest = "jump" if impact else "acceleration"
    kinds = ["position", "rate", highest, "jerk"][: 3 if impact else form.order + 1]
    for kind in kinds:
        labels += coordinate_labels(robot, coordinates, kind)
    names = ("impulse", "angular impulse") if impact else ("force", "moment")
    for suffix in ("", " rate") if kinds[-1] == "jerk" else ("",):
        for contact in context.contacts:
            labels += wrench_labels(contact.name, contact.rows, *(f"{name}{suffix}" for name in names))
    if form.time_scale is not None:
        labels.append(
            Label(owner=f"phase {free_phases[form.time_scale]}", kind="time scale", quantity="duration")
        )
    return labels


class SymbolNames:
    """Labels of the symbols of one context, by identity."""

    def __init__(self, context: Context, form: NodeLayout, free_phases: Sequence[str]) -> None:
        self._labels: dict[int, Label] = {}
        self._add(context.z, input_labels(context, form, free_phases))
        if context.uses_dynamics:
            torques = coordinate_labels(form.robot, context.coordinates, "torque")
            for row in form.robot.unactuated_rows:
                quantity = torques[row].quantity.replace("torque", "balance")
                torques[row] = Label(owner=torques[row].owner, kind="balance", quantity=quantity)
            self._add(context.generalized_forces, torques)
            self._add(context.force_rates, torques[: context.force_rates.numel()])
        for contact in context.used_accelerations:
            rows = context.held_rows(contact)
            labels = wrench_labels(contact.name, rows, "acceleration", "angular acceleration")
            self._add(context.contact_acceleration(contact), labels)
        for name, frame in context.frames.items():
            self._add(ca.vec(frame.rotation), [Label(owner=name, kind="frame", quantity="orientation")] * 9)
            self._add(frame.position, wrench_labels(name, (0, 1, 2), "position", ""))
            for twist, kinds in (
                (frame.velocity, ("velocity", "angular velocity")),
                (frame.acceleration, ("acceleration", "angular acceleration")),
            ):
                self._add(twist, wrench_labels(name, range(6), *kinds))

    def _add(self, symbols: ca.SX, labels: Sequence[Label]) -> None:
        for index, label in enumerate(labels):
            self._labels[symbols[index].element_hash()] = label

    def of(self, expression: ca.SX) -> list[Label]:
        """Labels of the symbols in an expression, without parameters, sorted."""
        labels = {self._labels.get(symbol.element_hash()) for symbol in ca.symvar(expression)}
        return sorted(label for label in labels if label is not None)

    def row(self, expression: ca.SX) -> str:
        """The subject of one row in words; empty if it has no owner or too many."""
        labels = self.of(expression)
        forces = [label for label in labels if label.kind in ("torque", "balance")]
        if len(forces) == 1:  # a drive's friction brings in the rate
            labels = forces
        by_owner: dict[str, list[str]] = {}
        for label in labels:
            by_owner.setdefault(label.owner, []).append(label.quantity)
        if not 0 < len(by_owner) <= MOST_OWNERS:
            return ""
        return "; ".join(f"{owner} {_shortened(parts)}" for owner, parts in by_owner.items())


def _shortened(quantities: Sequence[str]) -> str:
    """``force x, z`` for ``force x``, ``force z``."""
    by_head: dict[str, list[str]] = {}
    for quantity in quantities:
        head, _, axis = quantity.rpartition(" ")
        known = axis in (*AXES, *QUATERNION) and head
        by_head.setdefault(head if known else quantity, []).extend([axis] if known else [])
    return ", ".join(f"{head} {', '.join(axes)}".strip() for head, axes in by_head.items())
