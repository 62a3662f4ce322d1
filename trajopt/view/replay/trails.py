"""Trails of a replay: the paths of contact frames, or of an arm's tips, as thin lines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.parts import draw_line
from trajopt.view.replay.robot import tip_frames
from trajopt.view.replay.runs import DrawnSolution

TRAIL_COLOURS = (0x1F77B4, 0x2CA02C, 0x9467BD, 0xC77700)


def draw_trails(run: DrawnSolution) -> None:
    """Draw the path of each contact frame; of each tip if there are no contacts."""
    model, names, paths = run.solution.model, list(run.solution.contact_frames), run.motion.feet
    if not names:
        frames = tip_frames(model)
        names = [model.frames[frame].name for frame in frames]
        paths = _frame_paths(model, run.motion, frames)
    for number, name in enumerate(names):
        colour = run.ink(TRAIL_COLOURS[number % len(TRAIL_COLOURS)])
        draw_line(run.node["trails"][name.replace("/", "_")], paths[:, number], colour)


def _frame_paths(model: pin.Model, motion: ReplayMotion, frames: list[int]) -> np.ndarray:
    paths = np.empty((motion.n_frames, len(frames), 3))
    for column, frame in enumerate(frames):
        joint = model.frames[frame].parentJoint
        local = np.append(model.frames[frame].placement.translation, 1.0)
        paths[:, column] = (motion.joints[:, joint] @ local)[:, :3]
    return paths
