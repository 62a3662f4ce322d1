"""Videos of the gallery: plans in MuJoCo with whole-body control, the plan translucent over it."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from trajopt.motion.consistency import REQUESTS, SAMPLED
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families
from trajopt.simulation.simulate import simulate
from trajopt.view.replay.browser import Chromium
from trajopt.view.replay.show import replay

HEADING = "## Tracked in MuJoCo"
# Below the gallery's folder.
FOLDER = "tracked"
# Solutions of the suite that are shown, and how many cycles of a gait are simulated.
TRACKED = {
    "quadruped-backflip@go2": 1,
    "quadruped-barrel-roll@go2": 1,
    "biped-jump-forward@bolt": 1,
    "hopper-hop@hopper_space": 1,
    "biped-run@g1": 10,
    "quadruped-trot@anymal_c": 10,
}
# Of so many cycles the last ones are shown: a robot that goes far is small.
SHOWN_CYCLES = 2
# Pictures of a video, which plays in real time, and pixels of each side (taken larger, for smooth edges).
PICTURES, SIDE, LARGER = 20, 300, 1.5
# Layers that hide a small robot, or take bytes: all that does not move with it is stored once.
HIDDEN = ("com", "zmp", "support", "cones", "ghosts", "trails", "goals", "controller")


@dataclass(frozen=True, kw_only=True)
class Video:
    """A video of the gallery. base_error: of the simulation from the plan at the end, m; duration: s."""

    name: str
    cycles: int
    base_error: float
    duration: float
    pictures: tuple[Image.Image, ...]

    @property
    def file(self) -> str:
        """Its path below the gallery's folder."""
        return f"{FOLDER}/{self.name}.webp"


def chosen(folder: Path) -> dict[Path, int]:
    """Files of a folder of the suite that are shown, with their cycles."""
    files = {folder / f"{name}.npz": cycles for name, cycles in TRACKED.items()}
    return {path: cycles for path, cycles in files.items() if path.is_file()}


def video_of(browser: Chromium, path: Path, cycles: int) -> Video | None:
    """Simulate a plan and take its pictures; None if it is not tracked."""
    plan = Solution.load(path)
    simulation = simulate(plan, cycles=cycles, controller="whole-body")
    report = simulation.report
    if not report.passed:
        return None
    shown = [simulation.as_solution()]
    if cycles > 1:
        begin = report.duration * (1 - min(SHOWN_CYCLES, cycles) / cycles)
        shown = [from_time(shown[0], begin)]
    else:
        shown.append(plan)
    end = float(shown[0].t[0]) + report.duration * min(SHOWN_CYCLES, cycles) / cycles
    times = np.linspace(float(shown[0].t[0]), end, PICTURES, endpoint=False)
    return Video(
        name=path.stem,
        cycles=cycles,
        base_error=float(report.base_error_end or 0.0),
        duration=end - float(shown[0].t[0]),
        pictures=tuple(_pictures(browser, shown, times)),
    )


def _pictures(browser: Chromium, shown: list[Solution], times: np.ndarray) -> Iterator[Image.Image]:
    """Pictures at ``times`` (n,) s by a camera that stands still; the first solution is solid."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        replay(shown, html=page, layout="overlaid", labels=["simulation", "plan"][: len(shown)])
        with browser.opened(page, (round(LARGER * SIDE), round(LARGER * SIDE)), "bare") as view:
            view.camera("overview")
            for name in set(HIDDEN) & set(view.layers):
                view.layer(name, False)
            for time in times:
                view.seek(float(time))
                yield Image.fromarray(view.picture()).resize((SIDE, SIDE), Image.Resampling.LANCZOS)


def from_time(solution: Solution, begin: float) -> Solution:
    """The part of a simulated solution from the first interval on that starts at ``begin`` s or later."""
    first = int(np.searchsorted(solution.interval_t[:, 0], begin - 1e-9))
    rows = solution.interval >= first
    phase = int(solution.phase[rows][0])
    arrays = {name: solution.arrays[name][rows] for name in (*SAMPLED, *REQUESTS) if name in solution.arrays}
    plan = solution.description
    rest = {name: getattr(plan, name)[phase:] for name in ("phase_names", "surfaces", "patches")}
    changed = {"phase": arrays["phase"] - phase, "interval": arrays["interval"] - first}
    solution = solution.with_description(**rest)
    return replace(solution, interval_t=solution.interval_t[first:], **{**arrays, **changed})


def section(videos: list[Video]) -> str:
    """The part of the gallery's page with the videos; empty if there are none."""
    if not videos:
        return ""
    lines = [
        HEADING,
        "",
        "Plans in MuJoCo with [whole-body control](../control.md), in real time. The plan is translucent; of"
        f" ten cycles of a gait the last {SHOWN_CYCLES} are shown.",
        "",
        "    uv run python -m scripts.gallery --solutions out -o docs/gallery --tracked",
        "",
        "makes these videos alone, of the solutions in `out` with these names, `PROBLEM@ROBOT.npz`.",
    ]
    for video in videos:
        problem, robot = video.name.split("@")
        takes = problem in families() and families()[problem].takes_robot
        solve = f"trajopt solve {problem}" + (f" --set robot={robot}" if takes else "")
        cycles = f" --cycles {video.cycles}" if video.cycles > 1 else ""
        lines += [
            "",
            f"**{problem}** on {robot}: the base ends {1e3 * video.base_error:.1f} mm off the plan.",
            "",
        ]
        lines += [f"![{problem} on {robot}, tracked]({video.file})", ""]
        simulated = f"trajopt simulate plan.npz{cycles} --controller whole-body --html both.html"
        lines.append(f"`{solve} --output plan.npz; {simulated}`")
    return "\n".join(lines) + "\n"


def with_section(text: str, videos: list[Video]) -> str:
    """A gallery's page with these videos in place of those it has; its last part."""
    before = text.partition(f"\n{HEADING}")[0]
    own = section(videos)
    return f"{before}\n{own}" if own else before
