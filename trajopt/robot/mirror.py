"""Left-right symmetry of a robot about the x-z plane of its base, found from its geometry.

With S = diag(1, -1, 1), a pose T is mirrored to S T S, a twist (v, w) to (S v, -S w) and an inertia (m, c, I)
to (m, S c, S I S). Joint k is the mirror image of joint i if for all q

    T_k(s q) = S T_i(q) S C_i                         C_i constant, s = 1 or -1

This is tested joint by joint from the base. With parents mirrored by C_p and joint placements P,

    C_i = (S P_i S)^-1 C_p P_k,        Ad(C_i) s a_k = S a_i,        Ad(C_i) I_k = S I_i S

where a is the joint's axis as a twist. Names are not used. A joint may be its own image: with s = 1 it moves
in the plane (a pitch); with s = -1 it leaves it, and a mirrored motion holds it at zero (a yaw or a roll).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.dynamics.rerooting import joint_motion
from trajopt.errors import InputError
from trajopt.robot.robot import Robot

REFLECTION = np.array([1.0, -1.0, 1.0])
# Mirror image of a twist or of the local coordinates of a free-flyer (linear, angular), and of a wrench.
TWIST = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
# Mirror image of a body's parameters: mass, first moments, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
BODY = np.array([1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0])


def reflected(placement: pin.SE3) -> pin.SE3:
    """Mirror image S T S of a pose."""
    return pin.SE3(REFLECTION[:, None] * placement.rotation * REFLECTION, REFLECTION * placement.translation)


def reflected_inertia(inertia: pin.Inertia) -> pin.Inertia:
    """Mirror image of a body; by its parameters, as the constructor refuses what rounding makes negative."""
    return pin.Inertia.FromDynamicParameters(inertia.toDynamicParameters() * BODY)


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """Mirror image of every joint of a floating robot.

    Args:
        partner: image of each joint (njoints,); a joint on the plane may be its own image.
        sign: s of each joint.
        offset: C_i of each joint.
        asymmetry: largest mismatch of axes (rad, or relative to the robot's length) and of inertias and
            armatures (relative to mass, mass times length, and mass times length squared).
        worst: where that mismatch is.
    """

    partner: tuple[int, ...]
    sign: tuple[float, ...]
    offset: tuple[pin.SE3, ...]
    asymmetry: float
    worst: str


@dataclass
class _Match:
    """Images of the joints of a subtree: joint -> (partner, sign, offset), and the worst mismatch."""

    images: dict[int, tuple[int, float, pin.SE3]] = field(default_factory=dict)
    error: float = 0.0
    worst: str = ""

    def note(self, error: float, where: str) -> None:
        if error > self.error or not math.isfinite(error):
            self.error, self.worst = error, where

    def take(self, other: _Match) -> None:
        self.images |= other.images
        self.note(other.error, other.worst)


class _MirrorSearch:
    def __init__(self, robot: Robot) -> None:
        self.model, self.robot = robot.model, robot
        self.mass, self.length = robot.mass, robot.length
        self.children: list[list[int]] = [[] for _ in range(self.model.njoints)]
        for joint in range(1, self.model.njoints):
            self.children[int(self.model.parents[joint])].append(joint)

    def body(self, i: int, k: int, offset: pin.SE3, match: _Match) -> None:
        """Compare bodies i and k and match their children."""
        error = self.inertia_error(self.model.inertias[i], self.model.inertias[k], offset)
        match.note(error, f"inertia of '{self.model.names[i]}' and '{self.model.names[k]}'")
        ours, theirs = self.children[i], self.children[k]
        if len(ours) != len(theirs):
            match.note(math.inf, f"numbers of joints on '{self.model.names[i]}' and '{self.model.names[k]}'")
            return
        taken: set[int] = set()
        for a in ours:
            candidates = [(self.joint(a, b, offset), b) for b in theirs if b not in taken]
            best, b = min(candidates, key=lambda entry: entry[0].error)
            taken.add(b)
            match.take(best)

    def joint(self, i: int, k: int, parent: pin.SE3) -> _Match:
        """Match joints i and k, whose parents are images of each other with the offset ``parent``."""
        model, match = self.model, _Match()
        names = f"'{model.names[i]}' and '{model.names[k]}'"
        sizes = [(model.joints[j].nq, model.joints[j].nv) for j in (i, k)]
        if sizes[0] != sizes[1] or sizes[0][1] != 1:
            match.note(math.inf, f"kinds of joints {names}")
            return match
        offset = reflected(model.jointPlacements[i]).inverse() * parent * model.jointPlacements[k]
        motion = TWIST * joint_motion(model.joints[i]).vector
        image = offset.act(joint_motion(model.joints[k])).vector
        sign = 1.0 if motion @ image >= 0 else -1.0
        scale = np.array([1 / self.length] * 3 + [1.0] * 3)
        if not motion[3:].any():
            scale[:3] = 1.0
        alone = f"'{model.names[i]}' on one side, or off the plane"
        error = float(np.abs((sign * image - motion) * scale).max())
        match.note(error, f"axes of {names}" if i != k else alone)
        armature = np.array([model.armature[model.joints[j].idx_v] for j in (i, k)])
        unit = self.mass * (self.length**2 if motion[3:].any() else 1.0)
        match.note(float(np.abs(np.diff(armature))[0]) / unit, f"armature of {names}")
        match.images[i] = (k, sign, offset)
        if math.isfinite(match.error):
            self.body(i, k, offset, match)
        return match

    def inertia_error(self, inertia: pin.Inertia, other: pin.Inertia, offset: pin.SE3) -> float:
        difference = np.abs(reflected_inertia(inertia).matrix() - offset.act(other).matrix())
        units = np.full((6, 6), self.mass * self.length)
        units[:3, :3], units[3:, 3:] = self.mass, self.mass * self.length**2
        return float((difference / units).max())


def find_mirror(robot: Robot) -> Mirror:
    """Return the mirror image of every joint of a robot on a free-flyer.

    Raises `InputError` if the robot has another base, a part without a counterpart, or images that do not
    come in pairs.
    """
    model = robot.model
    if robot.base != "freeflyer" or not model.jointPlacements[1].isIdentity():
        raise InputError(f"robot '{robot.name}' has a {robot.base} base", "a free-flyer in world axes")
    match = _Match()
    match.images[1] = (1, 1.0, pin.SE3.Identity())
    _MirrorSearch(robot).body(1, 1, pin.SE3.Identity(), match)
    if not math.isfinite(match.error):
        raise InputError(
            f"robot '{robot.name}' has no mirror image: {match.worst} differ", "a symmetric robot"
        )
    every = range(1, model.njoints)
    if len(match.images) < len(every):
        raise InputError(f"robot '{robot.name}' has joints apart from its base", "one tree of joints")
    partner = (0, *(match.images[j][0] for j in every))
    lonely = [model.names[j] for j in every if partner[partner[j]] != j]
    if lonely:
        raise InputError(f"robot '{robot.name}' has joints without a mirror image: {', '.join(lonely)}")
    return Mirror(
        partner=partner,
        sign=(1.0, *(match.images[j][1] for j in every)),
        offset=(pin.SE3.Identity(), *(match.images[j][2] for j in every)),
        asymmetry=match.error,
        worst=match.worst,
    )


def paired_contacts(robot: Robot, mirror: Mirror, tolerance: float) -> tuple[int, ...]:
    """Index of the image of every contact (nc,): its own index if it lies on the plane.

    Raises `InputError` for a contact without an image within ``tolerance`` times the robot's length.
    """
    images = []
    for contact in robot.contacts:
        errors = [contact_error(robot, mirror, contact.name, other.name) for other in robot.contacts]
        best = int(np.argmin(errors))
        if not errors[best] <= tolerance:
            raise InputError(
                f"contact '{contact.name}' of robot '{robot.name}' has no mirror image within"
                f" {tolerance:g} of the robot's length",
                "contacts in mirrored pairs, or on the plane",
            )
        images.append(best)
    return tuple(images)


def contact_error(robot: Robot, mirror: Mirror, name: str, other: str) -> float:
    """Mismatch of a contact's mirror image and another contact, relative to the robot's length (and rad)."""
    given, image = robot.contact(name), robot.contact(other)
    frames = [robot.model.frames[robot.model.getFrameId(contact.frame)] for contact in (given, image)]
    joint = int(frames[0].parentJoint)
    if int(frames[1].parentJoint) != mirror.partner[joint] or given.kind != image.kind:
        return math.inf
    apart = reflected(frames[0].placement).inverse() * (mirror.offset[joint] * frames[1].placement)
    error = (float(np.linalg.norm(apart.translation)) + abs(given.radius - image.radius)) / robot.length
    if given.kind == "surface":
        sizes = np.array([[c.half_length, c.half_width] for c in (given, image)])
        error = max(error, float(np.abs(np.diff(sizes, axis=0)).max()) / robot.length)
        error = max(error, float(np.abs(np.abs(apart.rotation) - np.eye(3)).max()))
    return error


def limit_differences(robot: Robot, mirror: Mirror) -> list[str]:
    """Pairs of mirrored joints, as text, whose position, velocity or torque limits or drives differ."""
    differing = []
    for joint, image in pairs(robot, mirror):
        if not _same_limits(robot, mirror, joint, image):
            differing.append(f"'{robot.model.names[joint]}' and '{robot.model.names[image]}'")
    return differing


def pairs(robot: Robot, mirror: Mirror) -> list[tuple[int, int]]:
    """Pairs of joints that mirror each other, each pair once."""
    return [(j, mirror.partner[j]) for j in range(2, robot.model.njoints) if mirror.partner[j] > j]


def mirrored_range(lower: float, upper: float, sign: float) -> tuple[float, float]:
    """Position range of the image of a joint with this range."""
    return (lower, upper) if sign > 0 else (-upper, -lower)


def _same_limits(robot: Robot, mirror: Mirror, joint: int, image: int) -> bool:
    source, target = robot.model.joints[joint], robot.model.joints[image]
    ranges = [
        (robot.position_lower[j.idx_q], robot.position_upper[j.idx_q]) for j in (source, target)
    ]  # continuous joints have none
    same = [np.allclose(mirrored_range(*ranges[0], mirror.sign[joint]), ranges[1], rtol=1e-9, atol=1e-9)]
    same.append(bool(robot.velocity_limit[source.idx_v] == robot.velocity_limit[target.idx_v]))
    driven = np.isin([source.idx_v, target.idx_v], robot.actuated_rows)
    same.append(bool(driven[0] == driven[1]))
    one, other = np.searchsorted(robot.actuated_rows, [source.idx_v, target.idx_v])
    if robot.torque_limit is not None and driven.all():
        same.append(bool(robot.torque_limit[one] == robot.torque_limit[other]))
    if robot.drives is not None and driven.all():
        same.append(robot.drives[one] == robot.drives[other])
    return all(same)


def keepers(robot: Robot, mirror: Mirror, q: np.ndarray) -> tuple[int, ...]:
    """Joints kept in one half of the robot: those on the plane, and the left limb of each pair.

    The left limb is the one whose mass lies further to the left at ``q`` (nq,).
    """
    model, data = robot.model, robot.model.createData()
    pin.centerOfMass(model, data, q)
    y0 = data.oMi[1].translation[1]
    kept: set[int] = {1}
    for joint in range(2, model.njoints):
        parent, image = int(model.parents[joint]), mirror.partner[joint]
        if parent not in kept:
            continue
        on_plane = image == joint or mirror.partner[parent] != parent
        if on_plane or _leftward(model, data, joint, y0) > _leftward(model, data, image, y0):
            kept.add(joint)
    return tuple(sorted(kept))


def _leftward(model: pin.Model, data: pin.Data, joint: int, y0: float) -> tuple[float, int]:
    """Distance, m, of a limb's centre of mass to the left of the plane; in a tie the first joint is left."""
    com = data.oMi[joint].act(data.com[joint])
    return float(com[1] - y0), -joint


def mirrored_configuration(robot: Robot, mirror: Mirror, q: np.ndarray, y0: float) -> np.ndarray:
    """Mirror image (nq,) of a configuration about the plane y = y0."""
    image = np.array(q, dtype=float)
    image[1] = 2 * y0 - q[1]
    image[3:7] = [-q[3], q[4], -q[5], q[6]]
    for joint in range(2, robot.model.njoints):
        source, target = robot.model.joints[joint], robot.model.joints[mirror.partner[joint]]
        value = q[source.idx_q : source.idx_q + source.nq]
        image[target.idx_q : target.idx_q + target.nq] = signed(value, mirror.sign[joint])
    return image


def signed(value: np.ndarray, sign: float) -> np.ndarray:
    """Coordinates (..., nq) of a joint multiplied by 1 or -1; for (cos, sin) pairs, the angle is."""
    return value * (sign if value.shape[-1] == 1 else np.array([1.0, sign]))


def mirrored_rows(robot: Robot, mirror: Mirror) -> tuple[np.ndarray, np.ndarray]:
    """Indices and signs (nv,) that mirror rates and local coordinates: v' = sign v[index]."""
    index, sign = np.arange(robot.nv), np.ones(robot.nv)
    sign[:6] = TWIST
    for joint in range(2, robot.model.njoints):
        source, target = (robot.model.joints[j].idx_v for j in (joint, mirror.partner[joint]))
        index[target], sign[target] = source, mirror.sign[joint]
    return index, sign
