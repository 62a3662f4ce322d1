"""The solutions of one scene: each drawn below its own scene tree node, tinted or moved aside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trajopt.dynamics.base_joint import BASE_JOINT, base_of
from trajopt.errors import InputError
from trajopt.solution.solution import Solution
from trajopt.view.replay.motion import ReplayMotion
from trajopt.view.replay.robot import DrawnRobot, draw_robot, joint_path, subsample

LAYOUTS = ("overlaid", "side-by-side")

# Colours of several solutions, distinct for the colour-blind (Okabe and Ito, "Color universal design").
RUN_COLOURS = (0x5B6570, 0x0072B2, 0xD55E00, 0x009E73, 0xCC79A7, 0xE69F00, 0x56B4E9)
# Distance between neighbours side by side, in robot extents.
GAP = 0.4
# Frames at which the extent of a motion is measured.
MEASURED_FRAMES = 12
# Points of a mesh used for it.
MEASURED_POINTS = 300
# A motion travels if its base goes further along the ground than this many times the robot.
TRAVELS_FROM = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSolution:
    """One solution of a scene, drawn below ``node``, which is at ``root`` of the scene tree ("" for the top).

    colour: in legends, and of everything of the run if it is ``tinted``. robot: its drawing.
    cloud: (k, 3) m, world points of the drawn robot at a few frames. size: its largest extent at the start,
    m. shift: (3,) m from the world of the solution to the scene's.
    """

    solution: Solution
    motion: ReplayMotion
    node: Any
    root: str
    label: str
    colour: int
    tinted: bool
    robot: DrawnRobot = field(default_factory=DrawnRobot)
    cloud: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    size: float = 1.0
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def ink(self, colour: int) -> int:
        """Return the colour for a drawing of the run: the run's own if it is tinted."""
        return self.colour if self.tinted else colour

    @property
    def base_joint(self) -> int:
        """The joint that carries the base: the first one of a fixed base, 0 without joints."""
        model = self.solution.model
        return BASE_JOINT[base_of(model)] or min(1, model.njoints - 1)

    @property
    def base_path(self) -> str:
        """Scene tree path of the node that moves with the base."""
        return self.path(joint_path(self.solution.model, self.base_joint))

    @property
    def base(self) -> np.ndarray:
        """Positions (n, 3) of the base in the scene's world, m."""
        return np.asarray(self.motion.joints[:, self.base_joint, :3, 3] + self.shift)

    def path(self, place: str) -> str:
        """Scene tree path of a place below this run."""
        return f"{self.root}/{place}" if self.root else place


def require_labels(labels: Sequence[str] | None, count: int) -> None:
    """Raise `InputError` for labels of another number than ``count`` solutions."""
    if labels is not None and len(labels) != count:
        raise InputError(f"{len(labels)} labels for {count} solutions", "one for each, in their order")


def drawn_runs(
    vis: Any,
    solutions: Sequence[Solution],
    motions: Sequence[ReplayMotion],
    layout: str | None,
    labels: Sequence[str] | None,
) -> list[DrawnSolution]:
    """Draw the robot of every solution; those after the first are tinted (overlaid) or moved aside.

    Raises `InputError` for an unknown layout and for labels of another number.
    """
    if layout is None:
        layout = "side-by-side" if len({str(s.description.robot) for s in solutions}) > 1 else "overlaid"
    if layout not in LAYOUTS:
        raise InputError(f"unknown layout '{layout}'", f"allowed: {', '.join(LAYOUTS)}")
    require_labels(labels, len(solutions))
    names = list(labels) if labels is not None else _names(solutions)
    runs = []
    for number, (solution, motion) in enumerate(zip(solutions, motions, strict=True)):
        root = f"run{number}" if len(solutions) > 1 else ""
        run = DrawnSolution(
            solution=solution,
            motion=motion,
            node=vis[root] if root else vis,
            root=root,
            label=names[number],
            colour=RUN_COLOURS[number % len(RUN_COLOURS)],
            tinted=layout == "overlaid" and number > 0,
        )
        runs.append(_with_robot(run))
    return _aside(runs) if layout == "side-by-side" else runs


def _names(solutions: Sequence[Solution]) -> list[str]:
    """Problem and robot of each, numbered where they are the same."""
    names = [
        " ".join(filter(None, (s.description.problem, s.description.robot))) or "trajectory"
        for s in solutions
    ]
    twice = len(set(names)) < len(names)
    return [f"{name} ({number + 1})" if twice else name for number, name in enumerate(names)]


def _with_robot(run: DrawnSolution) -> DrawnSolution:
    robot = draw_robot(run.node, run.solution)
    rows = np.unique(np.linspace(0, run.motion.n_frames - 1, MEASURED_FRAMES).astype(int))
    parts = [np.zeros((len(rows), 0, 3))]
    for joint, points in robot.points.items():
        placement = run.motion.joints[rows, joint]
        local = np.concatenate([subsample(part, MEASURED_POINTS) for part in points])
        parts.append(local @ placement[:, :3, :3].transpose(0, 2, 1) + placement[:, None, :3, 3])
    cloud = np.concatenate(parts, axis=1)
    extent = float(np.ptp(cloud[0], axis=0).max()) if cloud.size else 0.0
    return replace(run, robot=robot, cloud=cloud.reshape(-1, 3), size=max(extent, 1e-3))


def _aside(runs: list[DrawnSolution]) -> list[DrawnSolution]:
    """Runs next to each other, across the longer level side of the first motion."""
    spans = np.ptp(runs[0].cloud[:, :2], axis=0)
    axis = 1 if spans[0] >= spans[1] else 0
    gap, place = GAP * max(run.size for run in runs), 0.0
    placed: list[DrawnSolution] = []
    for run in runs:
        low, high = run.cloud[:, axis].min(), run.cloud[:, axis].max()
        shift = np.zeros(3)
        shift[axis] = place - low if placed else 0.0
        place = shift[axis] + high + gap
        placed.append(replace(run, shift=shift))
    return placed


def travels(run: DrawnSolution, tangents: np.ndarray) -> bool:
    """Whether the base travels far along ground with these ``tangents`` (2, 3)."""
    along = (run.base - run.base[0]) @ tangents.T
    return float(np.ptp(along, axis=0).max()) > TRAVELS_FROM * run.size
