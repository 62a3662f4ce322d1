"""Limbs of a description, found from geometry: arms, legs, wheels, and balls or soles at the ends of legs."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from trajopt.collision.shapes import LinkShape
from trajopt.dynamics.base_joint import UNLIMITED, position_limits
from trajopt.robot.building import reach
from trajopt.robot.contact import Contact
from trajopt.robot.legs import HAND_HEIGHT

# A hand weighs at most the first fraction of what its arm's first joint moves; a joint without drive moves at
# most the second fraction of the total mass.
HAND_MASS, IDLE_MASS = 0.25, 0.02
# Bounds for a wheel: sine of its axis's angle to the ground, distance of its centre of mass from the axis
# over its radius of gyration.
WHEEL_TILT, WHEEL_OFFSET = 0.1, 0.2
# A joint of zero range, as files write it for "no limit", or of at least this one turns endlessly, rad.
ENDLESS = 1e3
# Corners of a prism are at one distance from its axis up to this fraction.
ROUND = 1e-3
# Least cosine of the angle between the axis of a rotor and the vertical.
UPRIGHT = 0.9
# A wheel behind this many joints is on a leg, one behind fewer on a caster.
LEG_JOINTS = 2
# Links of this name at the bottom are hands that hang.
HAND = re.compile("hand|grip|finger|thumb|palm|wrist|nub", re.IGNORECASE)
# Points of a foot this little above its lowest one are its sole, if it is at least that long; a frame at most
# that far above it is the centre of a ball. All over the height of the robot.
SOLE_LAYER, SOLE_LENGTH, BALL_HEIGHT = 0.003, 0.08, 0.1
# Least cosine of the angle by which a leg leans while it stands on its rounded end.
LEAN = 0.5
# A frame this near to the centre of a ball or wheel is at it, m.
SAME_PLACE = 1e-6
# Number of widths from which the largest rectangle in a sole is chosen, and its least half side, m.
WIDTHS, LEAST_HALF = 100, 1e-3
# Kinds of frames that may be feet: links and, in MJCF files, balls and sites.
TIPS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)

# A frame to add: the frame that it is fixed to, position (3,), m, and roll, pitch, yaw (3,), rad, in it.
AddedFrame = tuple[str, tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """What a guess takes for limbs, with all joints at zero or as near as limits allow.

    Args:
        wheels: joints of wheels, and those that carry wheels alone: swivels and springs.
        undriven: joints at the ends that have neither drive nor mass.
        is_fixed: whether the robot is an arm, or stands on its trunk.
        contacts: balls, soles and wheels that the robot stands on with a free base.
        frames: frames of the contacts that the description lacks, by name.
        coupled: joints that depend on others, and are locked.
    """

    wheels: tuple[str, ...] = ()
    undriven: tuple[str, ...] = ()
    is_fixed: bool = True
    contacts: tuple[Contact, ...] = ()
    frames: Mapping[str, AddedFrame] = field(default_factory=dict)
    coupled: tuple[str, ...] = ()


def find_limbs(model: pin.Model, shapes: Sequence[LinkShape] = ()) -> Limbs:
    """Limbs of a model on a fixed base, whose links have these shapes.

    A joint without drive moves no mass; or it moves little, and has an effort limit of 0 or none while others
    have one. Tips at the bottom are not counted among them, as they may be feet.
    """
    return _LimbSearch(model, shapes).limbs()


def tool_joint(model: pin.Model) -> int:
    """The last joint of the heaviest chain, before a light hand; 0 without joints."""
    data, children, joint = model.createData(), _children(model), 0
    pin.computeSubtreeMasses(model, data)
    while children[joint]:
        behind = [float(data.mass[child]) for child in children[joint]]
        if joint and len(behind) > 1 and sum(behind) <= HAND_MASS * data.mass[model.supports[joint][1]]:
            break
        joint = children[joint][int(np.argmax(behind))]
    return joint


def _children(model: pin.Model) -> list[list[int]]:
    parents = list(model.parents)
    return [[k for k in range(1, model.njoints) if parents[k] == joint] for joint in range(model.njoints)]


class _LimbSearch:
    def __init__(self, model: pin.Model, shapes: Sequence[LinkShape]) -> None:
        self.model, self.data, self.children = model, model.createData(), _children(model)
        posture = np.clip(pin.neutral(model), *position_limits(model))
        pin.computeJointJacobians(model, self.data, posture)
        pin.updateFramePlacements(model, self.data)
        pin.computeSubtreeMasses(model, self.data)
        largest = reach(model)
        # Points (k, 4) of each joint's shapes in the world, with their radius.
        self.points = [np.zeros((0, 4)) for _ in range(model.njoints)]
        for shape in shapes:
            frame = model.getFrameId(shape.frame)
            joint = int(model.frames[frame].parentJoint)
            if joint or shape.extent < largest:
                world = shape.points @ self.data.oMf[frame].rotation.T + self.data.oMf[frame].translation
                rows = np.column_stack([world, np.full(len(world), shape.radius)])
                self.points[joint] = np.vstack([self.points[joint], rows])
        self.ends = [end for limb in self.children[0] for end in self._ends(limb, limb)]
        heights = [place.translation[2] for place in self.data.oMi]
        self.low = {end: self._lowest(end) for end in self.ends}
        self.bottom = min(self.low.values(), default=0.0)
        trunk = self.points[0]
        self.trunk = float((trunk[:, 2] - trunk[:, 3]).min(initial=np.inf))
        self.height = max(heights + [float(p[:, 2].max()) for p in self.points if len(p)]) - self.bottom

    def limbs(self) -> Limbs:
        band = self.bottom + HAND_HEIGHT * self.height
        bottom = [end for end in self.ends if self.low[end] <= band]
        lowest = min(self.bottom, self.trunk) + HAND_HEIGHT * self.height
        wheels = [end for end in bottom if self.low[end] <= lowest and self._is_wheel(end)]
        wheels = wheels if len(wheels) > 1 else []  # one alone is a flywheel
        is_arm = len(set(self.ends) - set(wheels)) == 1
        rotors = [
            end for end in self.ends if self._turns_endlessly(end) and abs(self._axis(end)[2]) > UPRIGHT
        ]
        feet = [end for end in bottom if end not in rotors]
        feet = [end for end in feet if end in wheels or not HAND.search(self._tip(end))]
        feet = wheels if is_arm else feet
        on_legs = any(foot not in wheels or len(self.model.supports[foot]) > LEG_JOINTS + 2 for foot in feet)
        free = {*wheels, *rotors} >= set(self.ends)  # also without any
        is_fixed = not free and (is_arm or self.trunk <= band or not on_legs)
        undriven = self._undriven(set() if is_fixed else set(bottom))
        rolling = self._carrying(set(wheels)) if is_fixed else set(wheels)
        named = [tuple(str(self.model.names[j]) for j in sorted(each)) for each in (rolling, undriven)]
        frames: dict[str, AddedFrame] = {}
        contacts = [self._contact(foot, foot in wheels, frames) for foot in feet]
        return Limbs(
            wheels=named[0], undriven=named[1], is_fixed=is_fixed, contacts=tuple(contacts), frames=frames
        )

    def _ends(self, joint: int, limb: int) -> list[int]:
        """Last joints of the chains behind a joint, before light hands; ``limb`` begins its chain."""
        behind, mass = self.children[joint], self.data.mass
        if len(behind) == 1:
            return self._ends(behind[0], limb)
        if sum(mass[each] for each in behind) <= HAND_MASS * mass[limb]:
            return [joint]
        return [end for each in behind for end in self._ends(each, each)]

    def _lowest(self, joint: int) -> float:
        """Height of a joint's lowest point; without shapes of its farthest frame."""
        points = self.points[joint]
        if len(points):
            return float((points[:, 2] - points[:, 3]).min())
        tip = self._tip(joint)
        return float(self.data.oMf[self.model.getFrameId(tip)].translation[2])

    def _tip(self, joint: int) -> str:
        """The farthest body, ball or site of a joint; the joint's name without one."""
        frames = [f for f in self.model.frames if f.parentJoint == joint and f.type in TIPS]
        farthest = max(frames, key=lambda f: float(np.linalg.norm(f.placement.translation)), default=None)
        return str(self.model.names[joint] if farthest is None else farthest.name)

    def _link(self, joint: int) -> str:
        """The first body of a joint."""
        frames = self.model.frames
        bodies = (str(f.name) for f in frames if f.parentJoint == joint and f.type == pin.FrameType.BODY)
        return next(bodies, self._tip(joint))

    def _axis(self, joint: int) -> np.ndarray:
        """World axis (3,) of a joint of one degree of freedom; zero where it slides."""
        jacobian = np.reshape(self.data.J, (6, self.model.nv), order="F")  # of one column it is flat
        return np.asarray(jacobian[3:, self.model.joints[joint].idx_v])

    def _is_wheel(self, joint: int) -> bool:
        """Whether a tip turns without limits about a level axis through its body's centre of mass."""
        inertia = self.model.inertias[joint]
        if not self._turns_endlessly(joint) or inertia.mass <= 0:
            return False
        axis = self._axis(joint)
        off = np.linalg.norm(np.cross(axis, self.data.oMi[joint].rotation @ inertia.lever))
        radius = np.sqrt(np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
        return bool(abs(axis[2]) < WHEEL_TILT and off <= WHEEL_OFFSET * radius)

    def _turns_endlessly(self, joint: int) -> bool:
        kind = self.model.joints[joint]
        span = self.model.upperPositionLimit[kind.idx_q] - self.model.lowerPositionLimit[kind.idx_q]
        return kind.nv == 1 and (kind.nq == 2 or not 0 < span < ENDLESS) and bool(self._axis(joint).any())

    def _carrying(self, wheels: set[int]) -> set[int]:
        """The joints of wheels and of what carries nothing else."""
        carrying = set(wheels)
        for joint in reversed(range(1, self.model.njoints)):
            if self.children[joint] and carrying.issuperset(self.children[joint]):
                carrying.add(joint)
        return carrying

    def _undriven(self, kept: set[int]) -> set[int]:
        """Joints at the ends without drive or mass, except those ``kept``."""
        model, undriven = self.model, set[int]()
        driven = (model.upperEffortLimit > 0) & (model.upperEffortLimit < UNLIMITED)
        for joint in reversed(range(1, model.njoints)):
            kind, mass = model.joints[joint], self.data.mass[joint]
            idle = driven.any() and not driven[kind.idx_v : kind.idx_v + kind.nv].any()
            without = mass == 0 or (idle and mass <= IDLE_MASS * self.data.mass[0])
            if joint not in kept and without and undriven.issuperset(self.children[joint]):
                undriven.add(joint)
        return undriven

    def _contact(self, joint: int, rolls: bool, frames: dict[str, AddedFrame]) -> Contact:
        """The wheel, ball, sole or point with which a limb stands; its frame is added where there is none."""
        points, tip = self.points[joint], self._tip(joint)
        place = self.data.oMf[self.model.getFrameId(tip)].translation
        if not len(points):
            return Contact(frame=tip)
        if rolls:
            return self._wheel(joint, tip, frames)
        heights = points[:, 2] - points[:, 3]
        lowest = int(np.argmin(heights))
        layer = points[heights <= heights[lowest] + SOLE_LAYER * self.height, :2]
        if np.ptp(layer, axis=0).max() >= SOLE_LENGTH * self.height:
            middle, half = _rectangle(layer)
            if half.min() >= LEAST_HALF:
                frame = self._frame(self._link(joint), "sole", np.append(middle, heights[lowest]), frames)
                length, width = half.round(4).tolist()
                return Contact(frame=frame, kind="surface", half_length=length, half_width=width)
        radius = float(points[lowest, 3])
        if radius > SOLE_LAYER * self.height:  # a ball, and not the rounding of a hull
            return Contact(frame=self._frame(tip, "ball", points[lowest, :3], frames), radius=radius)
        ways = points[:, :3] - place  # of the rounded end of a leg around the frame
        far = np.linalg.norm(ways, axis=1)
        radius = float((far + points[:, 3])[-ways[:, 2] > LEAN * far].max(initial=0.0))
        if 0 < radius <= BALL_HEIGHT * self.height:
            return Contact(frame=tip, radius=round(radius, 4))
        return Contact(frame=self._frame(tip, "point", points[lowest, :3], frames))

    def _wheel(self, joint: int, tip: str, frames: dict[str, AddedFrame]) -> Contact:
        axis, origin = self._axis(joint), self.data.oMi[joint].translation
        points = self.points[joint]
        arms = points[:, :3] - origin
        along = arms @ axis
        middle = origin + axis * (along.min() + along.max()) / 2
        radii = np.linalg.norm(arms - np.outer(along, axis), axis=1) + points[:, 3]
        radius = float(radii.max())
        corners = int((radii > (1 - ROUND) * radius).sum())
        if not points[:, 3].any() and corners == len(radii):  # a prism around a cylinder
            radius *= math.cos(2 * math.pi / corners)
        radius = round(radius, 4)
        return Contact(frame=self._frame(tip, "wheel", middle, frames), radius=radius, rolling=True)

    def _frame(self, tip: str, what: str, place: np.ndarray, frames: dict[str, AddedFrame]) -> str:
        """A frame of the tip's joint at ``place`` (3,), world, m; one to add, level, if there is none."""
        index = self.model.getFrameId(tip)
        for number, frame in enumerate(self.model.frames):
            near = np.abs(self.data.oMf[number].translation - place).max() < SAME_PLACE
            own = frame.parentJoint == self.model.frames[index].parentJoint and frame.type in TIPS
            if what != "sole" and own and near:
                return str(frame.name)
        local = self.data.oMf[index].actInv(pin.SE3(np.eye(3), place))
        position, angles = (local.translation.round(5) + 0.0).tolist(), pin.rpy.matrixToRpy(local.rotation)
        frames[f"{tip}_{what}"] = tip, tuple(position), tuple((angles.round(6) + 0.0).tolist())
        return f"{tip}_{what}"


def _rectangle(layer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle (2,) and half sides (2,) of the largest rectangle along the axes in the hull of points (k, 2).

    It has the middle of their bounding box.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    middle = (layer.min(axis=0) + layer.max(axis=0)) / 2
    try:
        sides = ConvexHull(layer - middle).equations  # n . x + d <= 0
    except QhullError:  # points on a line
        return middle, np.zeros(2)
    widths = np.linspace(0.0, 1.0, WIDTHS + 2)[1:-1, None] * np.ptp(layer[:, 1]) / 2
    with np.errstate(divide="ignore"):
        lengths = ((-sides[:, 2] - np.abs(sides[:, 1]) * widths) / np.abs(sides[:, 0])).min(axis=1)
    best = int(np.argmax(lengths * widths[:, 0]))
    return middle, np.array([max(lengths[best], 0.0), widths[best, 0]])
