"""What a replay's page costs: seconds in a new process and again, bytes and what they are made of.

uv run trajopt solve solo12-jump --output jump.npz
uv run python -m scripts.replay_cost jump.npz
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
from pathlib import Path

import click

COLUMNS = ("file", "playback s", "imports s", "first s", "again s", "CPU s", "page MB")
PARTS = ("viewer", "meshes", "motion", "rest")


def measured(file: Path) -> dict[str, float]:
    """Seconds of the wall and of the processor, with the solution loaded, as after a solve; bytes by part."""
    from trajopt.solution import Solution

    solution = Solution.load(file)
    begun, busy = time.perf_counter(), time.process_time()
    from trajopt.replay import replay

    marks = [time.perf_counter() - begun]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "page.html"
        for _ in range(2):
            begun = time.perf_counter()
            shown = replay(solution, html=target)
            marks.append(time.perf_counter() - begun)
            if len(marks) == 2:
                busy = time.process_time() - busy
        parts = _parts(target.read_text())
    times = dict(zip(("imports", "first", "again"), marks, strict=True))
    return {**times, "cpu": busy, "duration": shown.duration, "page": shown.size, **parts}


def _parts(text: str) -> dict[str, float]:
    """Bytes of the page that hold the viewer, and shares of the packed scene by what is in it."""
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
    return {"viewer": len(held["viewer"]), **packed, "rest": rest}


@click.command()
@click.argument("files", nargs=-1, required=True, type=Path)
@click.option("--one", is_flag=True, hidden=True)
def main(files: tuple[Path, ...], one: bool) -> None:
    """Measure the replay of each FILE in a process of its own."""
    if one:
        click.echo(json.dumps(measured(files[0])))
        return
    click.echo("  ".join(f"{name:>10}" for name in (*COLUMNS, *(f"{part} MB" for part in PARTS))))
    for file in files:
        command = [sys.executable, "-m", "scripts.replay_cost", str(file), "--one"]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        seconds = [found[name] for name in ("duration", "imports", "first", "again", "cpu")]
        sizes = [found[name] / 1e6 for name in ("page", *PARTS)]
        click.echo("  ".join([f"{file.stem:>10}", *(f"{value:10.2f}" for value in (*seconds, *sizes))]))


if __name__ == "__main__":
    main()
