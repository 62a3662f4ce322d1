"""A replay as a video, an animated GIF or a picture, taken from its own page off screen."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from trajopt.errors import InputError
from trajopt.solution.input import SolutionOrFile, require_motion, solutions_of
from trajopt.solution.output import check_output, replacing
from trajopt.solution.solution import Solution
from trajopt.view.replay import video
from trajopt.view.replay.browser import AT_START, OpenedPage, open_page, require_chromium
from trajopt.view.replay.runs import require_labels
from trajopt.view.replay.shots import GAP, Shots, representative_time
from trajopt.view.replay.show import replay

_Progress = Callable[[int, int], None]

# Height of a strip's text over that of its pictures, and its distance from the edge over its height.
TEXT, TEXT_MARGIN = 0.055, 0.5
INK = (27, 37, 48)
# The page has 60 frames per second of playback: at this speed 600 per second of motion, which is enough.
SLOWEST = 0.1
# Poses at changes of phase, which a strip does not need.
GHOSTS = "ghosts"


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """The written file: path, number of pictures, duration in s (0 for a picture), pixels, bytes."""

    path: Path
    pictures: int
    duration: float
    width: int
    height: int
    size: int


def render(
    solutions: SolutionOrFile | Sequence[SolutionOrFile],
    target: str | Path,
    *,
    layout: str | None = None,
    labels: Sequence[str] | None = None,
    progress: _Progress | None = None,
    **options: Any,
) -> Rendering:
    """Write ``solutions`` to ``target``: a .mp4 (H.264), a .webp or .gif that repeats, or a .png.

    Picture k of a video shows the time start + k speed / fps, the last one the end. The file is written
    atomically.

    Args:
        solutions: One or several, or the paths of their files.
        target: The file.
        layout: Of several solutions, as in `replay`.
        labels: Their names.
        progress: Called with the number of pictures done and of all.
        **options: Fields of `Shots` (size, fps, speed, start, end, time, strip, camera, ...).

    Raises:
        InputError: For a value that is not allowed, a missing folder, Chromium or extra.
        TrajoptError: If Chromium or ffmpeg fails.
    """
    several = [require_motion(solution) for solution in solutions_of(solutions)]
    target = check_output(Path(target))
    known = [field.name for field in fields(Shots) if field.name != "ending"]
    unknown = ", ".join(sorted(set(options) - set(known)))
    if unknown:
        raise InputError(f"a rendering has no option {unknown}", f"allowed: {', '.join(known)}")
    shots = Shots(ending=target.suffix.lower(), **options)
    times = shots.times(*_span(several), representative_time(several[0]))
    require_labels(labels, len(several))
    if shots.is_video:
        video.find_ffmpeg()
    require_chromium()
    with replacing(target) as unfinished, tempfile.TemporaryDirectory(prefix="trajopt-") as folder:
        page = Path(folder, "page.html")
        speed = min(max(shots.speed, SLOWEST), 1.0)  # in slow motion the page has more frames
        replay(several, html=page, open_browser=False, speed=speed, layout=layout, labels=labels)
        fragment = AT_START + ("&panel=off" if shots.caption and not shots.strip else "&bare")
        with open_page(page, shots.pixels, fragment) as view:
            _arrange(view, shots)
            _write(unfinished, shots, times, _pictures(view, times, progress))
        size = unfinished.stat().st_size
    width, height = shots.canvas
    return Rendering(
        path=target,
        pictures=len(times),
        duration=float(len(times) / shots.rate) if shots.is_video else 0.0,
        width=width,
        height=height,
        size=size,
    )


def _span(solutions: Sequence[Solution]) -> tuple[float, float]:
    """First and last time of all, s."""
    if not solutions:
        raise InputError("there is nothing to render", "one or more solutions")
    return min(float(s.t[0]) for s in solutions), max(float(s.t[-1]) for s in solutions)


def _arrange(view: OpenedPage, shots: Shots) -> None:
    if shots.camera is not None:
        view.camera(shots.camera)
    crowded = [GHOSTS] if shots.strip and GHOSTS in view.layers else []
    for names, visible in ((crowded, False), (shots.hidden, False), (shots.shown, True)):
        for name in names:
            view.layer(name, visible)


def _pictures(view: OpenedPage, times: np.ndarray, progress: _Progress | None) -> Iterator[bytes]:
    """The page's pictures at ``times`` (s of the solution), one after the other, as PNG."""
    for done, t in enumerate(times, 1):
        view.seek(t)
        yield view.png()
        if progress is not None:
            progress(done, len(times))


def _write(target: Path, shots: Shots, times: np.ndarray, pictures: Iterator[bytes]) -> None:
    if shots.ending == ".mp4":
        video.write_mp4(target, pictures, shots.rate)
    elif shots.ending == ".webp":
        video.write_webp(target, pictures, shots.rate)
    elif shots.ending == ".gif":
        video.write_gif(target, pictures, shots.rate)
    else:
        _write_strip(target, shots, times, pictures)


def _write_strip(target: Path, shots: Shots, times: np.ndarray, pictures: Iterator[bytes]) -> None:
    """Write ``pictures`` side by side, with a gap; each with its time if there is text and more than one."""
    from PIL import Image, ImageDraw, ImageFont

    height, step = shots.pixels[1], shots.pixels[0] + GAP
    whole = Image.new("RGB", shots.canvas, "white")
    draw, letter = ImageDraw.Draw(whole), round(TEXT * height)
    font = ImageFont.load_default(size=letter)
    for number, (t, picture) in enumerate(zip(times, pictures, strict=True)):
        whole.paste(Image.open(io.BytesIO(picture)).convert("RGB"), (number * step, 0))
        if shots.caption and shots.strip:
            corner = (number * step + TEXT_MARGIN * letter, TEXT_MARGIN * letter)
            draw.text(corner, f"{t:.2f} s", fill=INK, font=font)
    whole.save(target, format="PNG", optimize=True)
