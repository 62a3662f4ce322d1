"""Solutions to plot, and the figures of their pages."""

from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.support import synthetic_motions
from tests.support.problems import hop
from tests.support.synthetic_motions import arm_motion, sampled
from trajopt import solve
from trajopt.motion.solution import Solution
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.view.plotting.track import Track, tracks_of
from trajopt.view.plotting.writing import sheet_of
from trajopt_library import robots


@lru_cache
def jump() -> Solution:
    """A hop of a floating robot with a sole that lands by an impact: phases, forces, impulses."""
    phases = (
        Phase(name="stance", duration=0.3, contacts=("foot",)),
        Phase(name="flight", duration=0.2),
        Phase(name="landing", duration=0.3, contacts=("foot",), impact=True),
    )
    return solve(hop("surface", schedule=Schedule(phases)), fixed_mesh=True)


@lru_cache
def arm() -> Solution:
    robot = robots.load("irb1600")
    drives = [None if drive is None else drive.to_meta() for drive in robot.drives]
    return sampled(robot, [arm_motion(robot)], 6, drives=drives)


@lru_cache
def standing() -> Solution:
    """A motion of Solo12 on four feet."""
    robot = robots.load("solo12")
    return sampled(robot, [synthetic_motions.standing(robot)], 6)


def track_of(solution: Solution) -> Track:
    return tracks_of([solution])[0]


def drawn(solution: Solution, name: str, *others: Solution) -> Figure:
    return sheet_of(tracks_of([solution, *others]), [name]).figure


def panels(figure: Figure) -> list[Axes]:
    """All axes of a figure, those side by side in a row and colour bars among them."""
    return figure.findobj(Axes)


def lines(figure: Figure, panel: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Data of the named lines of a panel, without gaps."""
    found = {}
    for axes in (axes for axes in panels(figure) if axes.get_label() == panel):
        for line in axes.get_lines():
            name = str(line.get_label())
            if not name.startswith("_"):
                x, y = (np.asarray(values, dtype=float) for values in line.get_data())
                keep = np.isfinite(y)
                found.setdefault(name, (x[keep], y[keep]))
    assert found, f"no panel {panel}"
    return found
