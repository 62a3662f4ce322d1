"""Cost of a replay's page: seconds in a new process and again, bytes by content, key frames.

The library is imported late: its imports are part of the measurement.
"""

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

SECONDS = ("playback", "imports", "first", "again", "CPU")
BYTES = ("page", "viewer", "meshes", "motion", "rest")
COUNTS = ("kept", "of")


@click.command()
@click.argument("files", nargs=-1, required=True)
def pages(files: tuple[str, ...]) -> None:
    """The replay of each FILE in a process of its own: seconds, MB by part, key frames kept of all."""
    from scripts.measure.shared import head, row

    titles = [f"{name}, {unit}" for names, unit in ((SECONDS, "s"), (BYTES, "MB")) for name in names]
    head("file", *titles, *COUNTS)
    for file in files:
        command = [sys.executable, "-m", "scripts.measure.pages", file]
        found = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
        figures = [f"{found[name]:.2f}" for name in SECONDS] + [f"{found[name] / 1e6:.2f}" for name in BYTES]
        row(Path(file).stem, *figures, *(found[name] for name in COUNTS))


def measured(file: Path) -> dict[str, float]:
    """Wall and processor time in s, with the solution loaded, as after a solve; bytes by part."""
    from trajopt.solution.solution import Solution

    solution = Solution.load(file)
    begun, busy = time.perf_counter(), time.process_time()
    from trajopt.view.replay.show import replay

    found = {"imports": time.perf_counter() - begun}
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "page.html"
        for name in ("first", "again"):
            begun = time.perf_counter()
            shown = replay(solution, html=target)
            found[name] = time.perf_counter() - begun
            found.setdefault("CPU", time.process_time() - busy)
        parts = _parts(target.read_text(), shown.frames)
    return {**found, "playback": shown.duration, "page": shown.size, **parts}


def _parts(text: str, frames: int) -> dict[str, float]:
    """Bytes of the page that hold the viewer, shares of the packed scene by content, key frames."""
    import umsgpack

    held = dict(re.findall(r'<script id="(viewer|scene)"[^>]*>([^<]*)</script>', text))
    scene = umsgpack.unpackb(gzip.decompress(base64.b64decode(held["scene"])))
    animation = [command for command in scene["commands"] if command["type"] == "set_animation"]
    packed = {
        "meshes": umsgpack.packb(scene["meshes"]),
        "motion": umsgpack.packb(animation, force_float_precision="single"),
    }
    sizes = {name: len(gzip.compress(data)) * 4 / 3 for name, data in packed.items()}  # as text of base64
    rest = len(text) - len(held["viewer"]) - sum(sizes.values())
    tracks = [track for entry in animation[0]["animations"] for track in entry["clip"]["tracks"]]
    kept = sum(len(track["times"].data) // 4 for track in tracks)
    return {"viewer": len(held["viewer"]), **sizes, "rest": rest, "kept": kept, "of": frames * len(tracks)}


if __name__ == "__main__":
    print(json.dumps(measured(Path(sys.argv[1]))))
