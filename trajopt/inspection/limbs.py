"""What a URDF's tree of joints is: an arm whose fingers branch at its end, wheels, joints without drive."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trajopt.inspection.faults import listed

# Branches at an arm's end weigh at most this part of what its first joint moves.
HAND_SHARE = 0.25
# A joint without drive that moves at most this part of all mass belongs to a gripper or a hand.
TINY = 0.02
# Of a wheel: sine of its axis's angle to the ground, how far its centre of mass is from the axis over its
# radius of gyration, and how high its axis is at most over the lowest joint, of the height of all joints.
LEVEL, CENTRED, LOW = 0.1, 0.2, 0.1
# Parsers write "no limit" as the largest double.
UNLIMITED = 1e20


@dataclass(frozen=True, kw_only=True)
class Limbs:
    """Names of joints to lock, and whether the rest is an arm, by `find_limbs`."""

    wheels: tuple[str, ...]
    undriven: tuple[str, ...]
    is_arm: bool

    @property
    def locked(self) -> tuple[str, ...]:
        """Joints that a guess locks."""
        return self.wheels + self.undriven

    @property
    def is_fixed(self) -> bool:
        """Whether a guess fixes the base: of an arm, or where it stands on wheels."""
        return self.is_arm or bool(self.wheels)

    def lines(self) -> tuple[str, ...]:
        """What a guess does with them, one line each."""
        texts = (
            ("wheels, locked and not taken as feet", self.wheels),
            ("joints of hands or grippers without drive, locked", self.undriven),
        )
        return tuple(f"guess: {text}: {listed(names)}" for text, names in texts if names)


def find_limbs(model: pin.Model) -> Limbs:
    """Wheels, joints without drive, and whether there is one limb, of a model on a fixed base.

    All joints are at zero. Joints without drive have an effort limit of 0, or none, where others have one,
    and move next to nothing, or they move no mass; tips at the bottom, which may be feet, are kept.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin.computeSubtreeMasses(model, data)
    joints, children = range(1, model.njoints), _children(model)
    wheels = {joint for joint in joints if not children[joint] and _is_wheel(model, data, joint)}
    is_arm = _is_arm(model, data, children, wheels)
    feet = set() if is_arm or wheels else _bottom(model, data, children)
    undriven: set[int] = set()
    for joint in reversed(joints):
        light = data.mass[joint] == 0 or _without_drive(model, data, joint)
        if light and joint not in wheels | feet and undriven.issuperset(children[joint]):
            undriven.add(joint)
    wheel_names, names = (tuple(str(model.names[j]) for j in sorted(each)) for each in (wheels, undriven))
    return Limbs(wheels=wheel_names, undriven=names, is_arm=is_arm)


def tool_joint(model: pin.Model) -> int:
    """The joint at the end of the heaviest chain, before a light hand; 0 without joints."""
    data, children, joint = model.createData(), _children(model), 0
    pin.computeSubtreeMasses(model, data)
    while children[joint]:
        behind = [float(data.mass[child]) for child in children[joint]]
        if joint and len(behind) > 1 and sum(behind) <= HAND_SHARE * data.mass[model.supports[joint][1]]:
            break
        joint = children[joint][int(np.argmax(behind))]
    return joint


def _children(model: pin.Model) -> list[list[int]]:
    children: list[list[int]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        children[int(model.parents[joint])].append(joint)
    return children


def _is_arm(model: pin.Model, data: pin.Data, children: list[list[int]], wheels: set[int]) -> bool:
    """Whether all joints but wheels are in one chain, or behind its end and light."""
    branches = [child for child in children[0] if child not in wheels]
    chain: list[int] = []
    while len(branches) == 1:
        chain.append(branches[0])
        branches = children[branches[0]]
    behind = sum(data.mass[branch] for branch in branches)
    return bool(chain) and behind <= HAND_SHARE * data.mass[chain[0]]


def _is_wheel(model: pin.Model, data: pin.Data, joint: int) -> bool:
    """Whether a joint turns about a level axis through its body's centre, without limits, at the bottom."""
    kind, inertia, q = model.joints[joint], model.inertias[joint], model.joints[joint].idx_q
    endless = kind.nq == 2 or model.lowerPositionLimit[q] == model.upperPositionLimit[q]
    if kind.nv != 1 or not endless or inertia.mass <= 0:
        return False
    axis = np.array(pin.computeJointJacobian(model, data, pin.neutral(model), joint)[3:, kind.idx_v])
    if not axis.any():  # it slides
        return False
    pin.forwardKinematics(model, data, pin.neutral(model))
    off = np.linalg.norm(np.cross(axis, inertia.lever))
    radius = np.sqrt(np.linalg.eigvalsh(inertia.inertia)[-1] / inertia.mass)
    heights = np.array([place.translation[2] for place in list(data.oMi)[1:]])
    low = data.oMi[joint].translation[2] <= heights.min() + LOW * np.ptp(heights)
    return bool(abs(data.oMi[joint].rotation @ axis)[2] < LEVEL and off <= CENTRED * radius and low)


def _without_drive(model: pin.Model, data: pin.Data, joint: int) -> bool:
    efforts = np.abs(model.upperEffortLimit)
    rows = slice(model.joints[joint].idx_v, model.joints[joint].idx_v + model.joints[joint].nv)
    driven = (efforts > 0) & (efforts < UNLIMITED)
    return bool(driven.any() and not driven[rows].any() and data.mass[joint] <= TINY * data.mass[0])


def _bottom(model: pin.Model, data: pin.Data, children: list[list[int]]) -> set[int]:
    """Joints of the tips that are lowest."""
    tips = [joint for joint in range(1, model.njoints) if not children[joint]]
    heights = {joint: float(data.oMi[joint].translation[2]) for joint in tips}
    lowest, spread = min(heights.values(), default=0.0), np.ptp([p.translation[2] for p in data.oMi])
    return {joint for joint, height in heights.items() if height - lowest <= LOW * spread}
