"""What replays cost: seconds, bytes of the page, key frames kept. `python -m scripts.replay_sizes FILE...`

Each line is one file: processor time, s, of everything from the solution to the written page, for the first
time in this process and for the second; key frames that are kept of those that every picture would make; the
page's size. With ``--repeat S`` the motion follows itself, on from where it ended, until it lasts S seconds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.replay import replay
from trajopt.replay.motion import motions_of
from trajopt.replay.scene import build_scene
from trajopt.solution import SAMPLED, Solution


def repeated(solution: Solution, seconds: float) -> Solution:
    """The motion one time after the other until it lasts ``seconds``; the base goes on along the level."""
    length = float(solution.t[-1] - solution.t[0])
    count, way = max(1, int(np.ceil(seconds / length))), np.zeros(solution.q.shape[1])
    way[:2] = solution.q[-1, :2] - solution.q[0, :2]
    steps = {"t": length, "q": way, "phase": int(solution.phase.max()) + 1, "interval": solution.n_intervals}
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(solution, name) + i * steps.get(name, 0) for i in range(count)])
        if name in steps
        else np.concatenate([getattr(solution, name)] * count)
        for name in SAMPLED
    }
    arrays["interval_t"] = np.concatenate([solution.interval_t + i * length for i in range(count)])
    lost = dict.fromkeys(("impulse", "impact_index", "row_multiplier", "row_place", "bound_multiplier"))
    meta = {**solution.meta, "phase_names": None, "surfaces": None, "patches": None, "payloads": None}
    return replace(solution, meta=meta, **arrays, **lost)


def key_frames(solution: Solution) -> tuple[int, int]:
    """Key frames of all tracks: those kept, and those of every picture."""
    motions = motions_of([solution])
    commands = build_scene([solution], motions).commands
    message = next(c.message for c in commands if c.message["type"] == "set_animation")
    tracks = [track for entry in message["animations"] for track in entry["clip"]["tracks"]]
    return sum(len(track["times"].data) // 4 for track in tracks), motions[0].n_frames * len(tracks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--repeat", type=float, default=0.0, metavar="S")
    given = parser.parse_args()
    for file in given.files:
        solution = Solution.load(file)
        solution = repeated(solution, given.repeat) if given.repeat else solution
        seconds = []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(2):
                begun = time.process_time()
                shown = replay(solution, html=Path(folder) / "page.html")
                seconds.append(time.process_time() - begun)
        kept, every = key_frames(solution)
        print(
            f"{file.stem:32s} {shown.duration:6.2f} s  {seconds[0]:5.2f} s {seconds[1]:5.2f} s  "
            f"{kept:7d} of {every:8d} key frames  {shown.size / 1e6:5.2f} MB",
            flush=True,
        )


if __name__ == "__main__":
    main()
