"""Trails of a replay: the paths of contact frames, or of an arm's tips, as thin lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from trajopt.solution.solution import Solution
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.parts import draw_line
from trajopt.view.replay.robot import tip_frames

TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)


def draw_trails(node: Any, solution: Solution, motion: ReplayMotion, tint: int | None = None) -> None:
    """Draw the path of each contact frame; of each tip if there are no contacts."""
    names, paths = list(solution.contact_frames), motion.feet
    if not names:
        frames = tip_frames(solution.model)
        names = [solution.model.frames[frame].name for frame in frames]
        paths = _frame_paths(solution.model, motion, frames)
    for number, name in enumerate(names):
        colour = TRAIL_COLOURS[number % len(TRAIL_COLOURS)] if tint is None else tint
        draw_line(node[name.replace("/", "_")], paths[:, number], colour)


def _frame_paths(model: pin.Model, motion: ReplayMotion, frames: list[int]) -> np.ndarray:
    paths = np.empty((motion.n_frames, len(frames), 3))
    for column, frame in enumerate(frames):
        joint = model.frames[frame].parentJoint
        local = np.append(model.frames[frame].placement.translation, 1.0)
        paths[:, column] = (motion.joints[:, joint] @ local)[:, :3]
    return paths
