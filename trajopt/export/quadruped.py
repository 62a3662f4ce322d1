"""The legs of a quadruped: four feet, each at the end of three joints that hang from a floating base."""

from dataclasses import dataclass

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, BASE_ROWS, base_of
from trajopt.errors import InputError
from trajopt.export.exported_motion import ExportedMotion

ALLOWED = "allowed: a quadruped with a floating base and three joints a leg"
# Joints of a leg.
JOINTS = 3


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A leg: its foot's frame, and its joints from hip to foot as columns of the motion's joints."""

    foot: str
    columns: tuple[int, ...]


def three_joint_legs(motion: ExportedMotion) -> dict[str, Leg]:
    """Legs by the names FR, FL, RR, RL, told apart by where their hips are (x ahead, y to the left).

    Raises `InputError` for any other robot.
    """
    model, feet = motion.model, motion.plan.contact_frames
    base = BASE_JOINT[base_of(model)]
    if BASE_ROWS[base_of(model)] != 6 or len(feet) != 4 or len(motion.joint_names) != 4 * JOINTS:
        raise InputError(
            f"{motion.robot} has {len(feet)} contacts and {len(motion.joint_names)} joints", ALLOWED
        )
    ends = [model.frames[model.getFrameId(foot)].parentJoint for foot in feet]
    chains = [list(model.supports[end])[base + 1 :] for end in ends]
    joints = sorted(joint for chain in chains for joint in chain)
    if joints != list(range(base + 1, model.njoints)) or {len(chain) for chain in chains} != {JOINTS}:
        raise InputError(f"the legs of {motion.robot} do not have three joints each", ALLOWED)
    hips = np.array([model.jointPlacements[chain[0]].translation for chain in chains])
    by_x = np.argsort(-hips[:, 0], kind="stable")
    legs = {}
    for place, pair in (("F", by_x[:2]), ("R", by_x[2:])):
        right, left = sorted(pair, key=lambda i: hips[i, 1])
        for side, i in (("R", right), ("L", left)):
            columns = tuple(motion.joint_names.index(model.names[joint]) for joint in chains[i])
            legs[place + side] = Leg(foot=feet[i], columns=columns)
    return legs
