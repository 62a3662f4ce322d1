"""What a replay's page costs: seconds in a new process and again, bytes by what they are made of, key frames.

uv run trajopt solve solo12-jump --output jump.npz
uv run python -m scripts.replay_cost jump.npz

Key frames are those that are kept, of those that every picture would make. With ``--repeat S`` the motion
follows itself, on from where it ended, until it lasts S seconds.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

if TYPE_CHECKING:
    from trajopt.solution.solution import Solution

# Of a solution that a motion put after itself has no more.
LOST_ARRAYS = ("impulse", "impact_index", "row_multiplier", "row_place", "bound_multiplier")
LOST_FACTS = ("phase_names", "surfaces", "patches", "payloads")
COLUMNS = ("file", "playback s", "imports s", "first s", "again s", "CPU s", "page MB")
COUNTS = ("kept", "of")
PARTS = ("viewer", "meshes", "motion", "rest")


def measured(file: Path, seconds: float) -> dict[str, float]:
    """Seconds of the wall and of the processor, with the solution loaded, as after a solve; bytes by part."""
    from trajopt.solution.solution import Solution

    solution = repeated(Solution.load(file), seconds)
    begun, busy = time.perf_counter(), time.process_time()
    from trajopt.view.replay.show import replay

    marks = [time.perf_counter() - begun]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "page.html"
        for _ in range(2):
            begun = time.perf_counter()
            shown = replay(solution, html=target)
            marks.append(time.perf_counter() - begun)
            if len(marks) == 2:
                busy = time.process_time() - busy
        parts = _parts(target.read_text(), shown.frames)
    times = dict(zip(("imports", "first", "again"), marks, strict=True))
    return {**times, "cpu": busy, "duration": shown.duration, "page": shown.size, **parts}


def _parts(text: str, frames: int) -> dict[str, float]:
    """Bytes of the page that hold the viewer, shares of the packed scene by what is in it, key frames."""
    import umsgpack

    held = dict(re.findall(r'<script id="(viewer|scene)"[^>]*>([^<]*)</script>', text))
    scene = umsgpack.unpackb(gzip.decompress(base64.b64decode(held["scene"])))
    animation = [command for command in scene["commands"] if command["type"] == "set_animation"]
    packed = {
        "meshes": len(gzip.compress(umsgpack.packb(scene["meshes"]))),
        "motion": len(gzip.compress(umsgpack.packb(animation, force_float_precision="single"))),
    }
    packed = {name: size * 4 / 3 for name, size in packed.items()}  # as text of base64
    rest = len(text) - len(held["viewer"]) - sum(packed.values())
    tracks = [track for entry in animation[0]["animations"] for track in entry["clip"]["tracks"]]
    counts = {"kept": sum(len(track["times"].data) // 4 for track in tracks), "of": frames * len(tracks)}
    return {"viewer": len(held["viewer"]), **packed, "rest": rest, **counts}


def repeated(solution: Solution, seconds: float) -> Solution:
    """The motion one time after the other until it lasts ``seconds``; the base goes on along the level."""
    from trajopt.solution.arrays import SAMPLED

    length = float(solution.t[-1] - solution.t[0])
    if seconds <= length:
        return solution
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
    meta = {**solution.meta, **dict.fromkeys(LOST_FACTS)}
    return replace(solution, meta=meta, **arrays, **dict.fromkeys(LOST_ARRAYS))


@click.command()
@click.argument("files", nargs=-1, required=True, type=Path)
@click.option("--repeat", type=float, default=0.0, metavar="S", help="Until it lasts S seconds.")
@click.option("--one", is_flag=True, hidden=True)
def main(files: tuple[Path, ...], repeat: float, one: bool) -> None:
    """Measure the replay of each FILE in a process of its own."""
    if one:
        click.echo(json.dumps(measured(files[0], repeat)))
        return
    click.echo(
        "  ".join(f"{name:>10}" for name in (*COLUMNS, *(f"{part} MB" for part in PARTS), "kept", "of"))
    )
    for file in files:
        command = [sys.executable, "-m", "scripts.replay_cost", str(file), "--one", f"--repeat={repeat}"]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        seconds = [found[name] for name in ("duration", "imports", "first", "again", "cpu")]
        sizes = [found[name] / 1e6 for name in ("page", *PARTS)]
        figures = [f"{value:10.2f}" for value in (*seconds, *sizes)]
        counts = [f"{found[name]:10}" for name in COUNTS]
        click.echo("  ".join([f"{file.stem:>10}", *figures, *counts]))


if __name__ == "__main__":
    main()
