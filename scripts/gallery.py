"""A gallery of the suite's solutions: a strip of pictures of each, as a page for code hosts and one to play.

trajopt bench suite --output-dir out
uv run python -m scripts.gallery --solutions out -o docs/gallery
uv run python -m scripts.gallery --solutions out -o gallery --pages      # and index.html, whose tiles play
uv run python -m scripts.gallery --solutions out -o docs/gallery --tracked   # only videos of simulations
"""

import argparse
import html
import io
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scripts import gallery_videos
from scripts.gallery_videos import Video
from trajopt.dynamics.base_joint import base_of
from trajopt.errors import InputError, TrajoptError
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families
from trajopt.solving.ladder import total_effort
from trajopt.view.replay.browser import Chromium, chromium
from trajopt.view.replay.show import replay

# Title, page of docs/problems, and patterns of names: the first that fits counts.
GROUPS = (
    ("Arms", "arms.md", ("arm-*", "ur5-*", "irb1600-*")),
    ("Multirotors", "multirotors.md", ("quadrotor-*",)),
    ("Jumps and flips", "jumps.md", ("*-jump", "quadruped-jump-*", "*flip", "*-barrel-roll", "*-stand-up")),
    ("Terrain", "terrain.md", ("*-box-*", "*-gap", "*-slope", "*-stairs", "*-steps", "*-stones", "*-waves")),
    ("Gaits", "gaits.md", ("quadruped-*",)),
    ("Bipeds", "bipeds.md", ("biped-*", "humanoid-*", "talos-*")),
    ("Hoppers and classics", "classics.md", ("*",)),
)
# Pictures of a strip, pixels of each (taken larger, for smooth edges), and bytes of a strip at most.
PICTURES, WIDTH, HEIGHT, LARGER, MOST_BYTES = 3, 400, 400, 1.3, 33_000
# The camera follows a motion that is this many times as long as the robot, else a picture shows it all.
FOLLOWED = 1.6
# How much larger than in the page a robot is, as what matters is in the middle; not if it is higher than this
# many times its width.
CLOSE, TALL = 1.15, 1.3
CLOSER = """zoom => {
    trajopt.viewer.camera.zoom = zoom;
    trajopt.viewer.camera.updateProjectionMatrix();
    trajopt.viewer.set_dirty();
}"""
# A leap is shown from this part of its flight's duration before take-off to as much after touchdown.
AROUND = 0.25
# Qualities of WebP, tried in this order until the strip is small enough.
QUALITIES = (80, 70, 60, 50, 40, 30, 20)
# Layers that would hide a small robot.
HIDDEN = ("com", "zmp", "support", "cones", "ghosts")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A solution of the gallery. ``name`` is its file's without ending; duration in s."""

    name: str
    problem: str
    robot: str
    summary: str
    duration: float
    objective: float
    iterations: int
    group: int


def chosen(folder: Path) -> tuple[Path, ...]:
    """One solution file per problem: of the robot used least so far; problems with fewest robots first.

    Raises `InputError` for a folder without files ``PROBLEM@ROBOT.npz``, those of ``trajopt bench suite``.
    """
    files: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.glob("*@*.npz")):
        files[path.stem.split("@")[0]].append(path)
    if not files:
        raise InputError(
            f"{folder} has no file PROBLEM@ROBOT.npz", "a folder of trajopt bench suite --output-dir"
        )
    taken: Counter[str] = Counter()
    found = []
    for paths in sorted(files.values(), key=lambda paths: (len(paths), paths[0].name)):
        path = min(paths, key=lambda path: taken[path.stem.split("@")[1]])
        taken[path.stem.split("@")[1]] += 1
        found.append(path)
    return tuple(sorted(found))


def entry_of(name: str, solution: Solution) -> Entry:
    """The gallery's entry for a solution."""
    statistics, problem = solution.statistics, name.split("@")[0]
    family = families().get(problem)
    return Entry(
        name=name,
        problem=problem,
        robot=name.split("@")[1],
        summary=family.summary if family is not None else "",
        duration=float(solution.t[-1] - solution.t[0]),
        objective=float(statistics.objective),
        iterations=int(total_effort([solution])["iterations"]),
        group=next(i for i, (_, _, fits) in enumerate(GROUPS) if any(fnmatch(problem, p) for p in fits)),
    )


def times_of(solution: Solution) -> np.ndarray:
    """Times (PICTURES,) in s that show what happens: around a leap's flight, or over the whole motion."""
    start, end = float(solution.t[0]), float(solution.t[-1])
    flights = [rows for rows in solution.phases if not solution.active[rows.start : rows.stop].any()]
    leaps = solution.active.any() and len(flights) == 1 and not solution.description.periodicity
    if leaps:
        first, last = (float(solution.t[flights[0][index]]) for index in (0, -1))
        margin = AROUND * (last - first)
        start, end = max(start, first - margin), min(end, last + margin)
    return np.linspace(start, end, PICTURES)


def camera_of(facts: Mapping[str, Any], cameras: Sequence[str]) -> str:
    """The camera that shows the robot large: of those of the page, one that follows it if it goes far."""
    far = np.ptp(np.array(facts["box"]), axis=0).max() > FOLLOWED * facts["size"]
    return "follow" if far and "follow" in cameras else "overview"


def zoom_of(facts: Mapping[str, Any]) -> float:
    """How much larger than in the page a motion is shown."""
    spans = np.ptp(np.array(facts["box"]), axis=0)
    return 1.0 if spans[2] > TALL * spans[:2].max() else CLOSE


def strip_of(browser: Chromium, page: Path, solution: Solution, facts: Mapping[str, Any]) -> Image.Image:
    """Pictures of a solution in its page side by side, `WIDTH` by `HEIGHT` each, framed on the robot."""
    with browser.opened(page, (round(LARGER * WIDTH), round(LARGER * HEIGHT)), "bare") as view:
        moving = base_of(solution.model) != "fixed"
        view.camera(camera_of(facts, view.cameras if moving else ("overview",)))
        view.evaluate(CLOSER, zoom_of(facts))
        for name in set(HIDDEN) & set(view.layers):
            view.layer(name, False)
        whole = Image.new("RGB", (WIDTH * PICTURES, HEIGHT))
        for number, time in enumerate(times_of(solution)):
            view.seek(float(time))
            picture = Image.fromarray(view.picture()).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
            whole.paste(picture, (number * WIDTH, 0))
    return whole


def packed(picture: Image.Image, others: Sequence[Image.Image] = (), lasts: float = 0.0) -> bytes:
    """The picture as WebP, in the best of ``QUALITIES`` that is small enough.

    With ``others`` it is animated, and repeats: each picture ``lasts`` s.
    """
    data, animated = b"", {}
    if others:
        animated = {"save_all": True, "append_images": others, "duration": round(1e3 * lasts), "loop": 0}
    for quality in QUALITIES:
        buffer = io.BytesIO()
        picture.save(buffer, "WEBP", quality=quality, method=6, minimize_size=bool(others), **animated)
        data = buffer.getvalue()
        if len(data) <= MOST_BYTES:
            break
    return data


def add(browser: Chromium, path: Path, target: Path, keep_page: bool) -> Entry:
    """Write the strip of a solution file to ``target``, and its page with ``keep_page``."""
    solution = Solution.load(path)
    with tempfile.TemporaryDirectory() as folder:
        page = (target if keep_page else Path(folder)) / f"{path.stem}.html"
        shown = replay(solution, html=page)
        picture = strip_of(browser, page, solution, shown.facts)
    (target / f"{path.stem}.webp").write_bytes(packed(picture))
    return entry_of(path.stem, solution)


def add_videos(browser: Chromium, solutions: Path, target: Path) -> list[Video]:
    """Write the videos of a folder of solutions; what is not tracked is left out, with a line on stderr."""
    found = []
    for path, cycles in gallery_videos.chosen(solutions).items():
        video = gallery_videos.video_of(browser, path, cycles)
        print(f"{path.stem}: {'tracked' if video else 'not tracked, left out'}", file=sys.stderr)
        if video is not None:
            file = target / video.file
            file.parent.mkdir(exist_ok=True)
            first, *others = video.pictures
            file.write_bytes(packed(first, others, video.duration / len(video.pictures)))
            found.append(video)
    return found


def make_videos(solutions: Path, target: Path) -> list[Video]:
    """Write videos alone into a gallery; raises `TrajoptError`, one line."""
    page = target / "README.md"
    if not page.is_file():
        raise InputError(f"{target} has no README.md", "a gallery, to which --tracked adds videos")
    with chromium() as browser:
        videos = add_videos(browser, solutions, target)
    page.write_text(gallery_videos.with_section(page.read_text(encoding="utf-8"), videos), encoding="utf-8")
    return videos


def readme(entries: Sequence[Entry]) -> str:
    """The gallery as Markdown, for a code host."""
    lines = [
        "# Gallery",
        "",
        f"{len(entries)} of the library's motions, each on one of its robots, solved with default parameters"
        " from the default guess. Time runs from left to right; red arrows are contact forces.",
        "",
        "    trajopt bench suite --output-dir out",
        "    uv run python -m scripts.gallery --solutions out -o docs/gallery",
        "",
        "makes this page, with one robot for each problem; with `--pages` also an `index.html` whose pictures"
        " open replays, as those on the documentation's site do.",
    ]
    for number, (title, document, _) in enumerate(GROUPS):
        members = [entry for entry in entries if entry.group == number]
        if members:
            lines += ["", f"## [{title}](../problems/{document})"]
        for entry in members:
            lines += ["", f"**{entry.problem}** on {entry.robot}: {entry.summary}.", ""]
            lines += [f"![{entry.problem} on {entry.robot}]({entry.name}.webp)", "", _figures(entry)]
    return "\n".join(lines) + "\n"


def _figures(entry: Entry) -> str:
    return (
        f"{entry.duration:.2f} s, objective {entry.objective:.4g}, {entry.iterations} iterations:"
        f" `{_command(entry)}`"
    )


def _command(entry: Entry) -> str:
    takes = entry.problem in families() and families()[entry.problem].takes_robot
    return f"trajopt solve {entry.problem}" + (f" --set robot={entry.robot}" if takes else "")


STYLE = """body { margin: 2em auto; max-width: 1240px; font: 15px/1.5 system-ui, sans-serif; color: #1b2530; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(560px, 1fr)); gap: 1.2em; }
a { color: inherit; text-decoration: none; } img { width: 100%; border-radius: 6px; display: block; }
a:hover img { outline: 3px solid #2f6db5; } small { color: #5a6675; } h2 { margin-top: 1.6em; }"""


def index(entries: Sequence[Entry]) -> str:
    """The gallery as a page whose pictures open the pages that play."""
    parts = []
    for number, (title, _, _) in enumerate(GROUPS):
        members = [entry for entry in entries if entry.group == number]
        tiles = [
            f'<a href="{html.escape(entry.name)}.html"><img src="{html.escape(entry.name)}.webp" alt="">'
            f"<b>{html.escape(entry.problem)}</b> on {html.escape(entry.robot)}<br>"
            f"<small>{entry.duration:.2f} s, objective {entry.objective:.4g},"
            f" {entry.iterations} iterations</small></a>"
            for entry in members
        ]
        if tiles:
            parts.append(f"<h2>{html.escape(title)}</h2>\n<main>\n" + "\n".join(tiles) + "\n</main>")
    head = (
        f'<!DOCTYPE html>\n<html lang="en"><meta charset="utf-8"><title>Gallery</title><style>{STYLE}</style>'
    )
    return head + "\n<h1>Gallery</h1>\n" + "\n".join(parts) + "\n</html>\n"


def make(solutions: Path, target: Path, pages: bool) -> tuple[Entry, ...]:
    """Write the gallery of a folder of solutions; raises `TrajoptError`, one line."""
    files = chosen(solutions)
    target.mkdir(parents=True, exist_ok=True)
    found = []
    with chromium() as browser:
        for number, path in enumerate(files, 1):
            found.append(add(browser, path, target, pages))
            print(f"{number}/{len(files)} {path.stem}", file=sys.stderr)
        videos = add_videos(browser, solutions, target)
    entries = tuple(found)
    text = gallery_videos.with_section(readme(entries), videos)
    (target / "README.md").write_text(text, encoding="utf-8")
    if pages:
        (target / "index.html").write_text(index(entries), encoding="utf-8")
    return entries


def main() -> None:
    """Write the gallery from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--solutions", type=Path, required=True, metavar="DIR", help="of trajopt bench suite")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--pages", action="store_true", help="also pages that play, and index.html")
    parser.add_argument("--tracked", action="store_true", help="only videos of plans in MuJoCo")
    given = parser.parse_args()
    try:
        if given.tracked:
            files = [video.file for video in make_videos(given.solutions, given.output)]
        else:
            files = [f"{entry.name}.webp" for entry in make(given.solutions, given.output, given.pages)]
    except TrajoptError as error:
        sys.exit(f"gallery: {error}")
    size = sum((given.output / name).stat().st_size for name in files)
    print(f"{given.output}: {len(files)} motions, {size / 1e6:.2f} MB of pictures")


if __name__ == "__main__":
    main()
