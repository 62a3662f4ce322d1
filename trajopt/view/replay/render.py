"""A replay as a video, an animated GIF or a picture, taken from its own page off screen."""

import io
import itertools
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from trajopt.arguments import checked
from trajopt.errors import InputError
from trajopt.kinds import Range
from trajopt.motion.input import SolutionOrFile, require_motion, solutions_of
from trajopt.motion.output import check_output, replacing
from trajopt.motion.solution import Solution
from trajopt.view.replay import video
from trajopt.view.replay.browser import AT_START, OpenedPage, open_page, require_chromium
from trajopt.view.replay.motion import FASTEST
from trajopt.view.replay.runs import require_labels
from trajopt.view.replay.show import replay

# Pixels (width, height): fewer for a GIF, which compresses badly; of each picture of a strip.
SIZES = {".mp4": (1280, 720), ".webp": (960, 540), ".gif": (640, 360), ".png": (1280, 720)}
STRIP_SIZE = (480, 480)
# Pixels between the pictures of a strip.
GAP = 6
# Sides in pixels: the least that is useful, and the most that is drawn in seconds without a graphics card.
LEAST_SIDE, MOST_SIDE = 64, 4096
# Largest width of a strip in pixels.
MOST_WIDTH = 32768
# Pictures a second; the times of a GIF are hundredths of a second, and viewers slow down below two of them.
RATES = {".mp4": 30.0, ".webp": 25.0, ".gif": 25.0}
MOST_RATE = {".mp4": 240.0, ".webp": 50.0, ".gif": 50.0}
MOST_PICTURES, MOST_STRIP = 100_000, 32
# Denominators of pictures a second: 30000/1001 is met exactly.
FINEST_RATE = 1001
# Rounding error, in pictures, allowed at the end of a motion.
SAME_TIME = 1e-6

# Kinds of file to which an option applies, for options that do not apply to all.
USES = {
    **dict.fromkeys(("fps", "speed"), "a video"),
    "time": "a .png of one picture, which is without strip",
    "strip": "a .png",
    **dict.fromkeys(("start", "end"), "a video, or a .png with strip"),
}
_Progress = Callable[[int, int], None]

# Height of a strip's text over that of its pictures, and its distance from the edge over its height.
TEXT, TEXT_MARGIN = 0.055, 0.5
INK = (27, 37, 48)
# The page has 60 frames per second of playback: 600 per second of motion at this speed, which is enough.
SLOWEST = 0.1
# Poses at changes of phase, which a strip does not need.
GHOSTS = "ghosts"


@checked
@dataclass(frozen=True, kw_only=True)
class Shots:
    """Pictures of a replay for one file.

    Args:
        ending: suffix of the file, one of `SIZES`.
        size: pixels (width, height), of each picture of a strip; default by suffix.
        fps: pictures per second of a video.
        speed: seconds of the motion per second of video.
        start: of the time span in the solution, s; default: of the motion.
        end: of the time span, s.
        time: of the solution, s, for a single picture.
        strip: number of pictures side by side in a .png, from start to end.
        camera: one of the page's cameras.
        caption: whether there is text.
        hidden: names of layers.
        shown: names of layers.

    Raises `InputError`, one line, for values out of range and for those that do not fit together.
    """

    ending: str
    size: tuple[int, int] | None = None
    fps: float | None = None
    speed: Annotated[float, Range(0.0, FASTEST, above=True)] = 1.0
    start: float | None = None
    end: float | None = None
    time: float | None = None
    strip: Annotated[int, Range(2, MOST_STRIP)] | None = None
    camera: str | None = None
    caption: bool = True
    hidden: Sequence[str] = ()
    shown: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.ending not in SIZES:
            name = f"'{self.ending}'" if self.ending else "missing"
            raise InputError(f"the ending of the output is {name}", "allowed: " + ", ".join(SIZES))
        self._check_use()
        self._check_size()
        if self.fps is not None and not 1 <= self.fps <= MOST_RATE[self.ending]:
            most = MOST_RATE[self.ending]
            raise InputError(f"fps is {self.fps:g}", f"allowed for a {self.ending}: 1 to {most:g}")

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of one picture."""
        return self.size or (STRIP_SIZE if self.strip else SIZES[self.ending])

    @property
    def canvas(self) -> tuple[int, int]:
        """Width and height of the whole picture."""
        width, height = self.pixels
        return (width + GAP) * (self.strip or 1) - GAP, height

    @property
    def rate(self) -> Fraction:
        """Pictures a second of a video."""
        return Fraction(self.fps or RATES[self.ending]).limit_denominator(FINEST_RATE)

    @property
    def is_video(self) -> bool:
        """Whether it is a video: several pictures in sequence."""
        return self.ending in RATES

    def times(self, first: float, last: float, telling: float) -> np.ndarray:
        """Return the times (n,) of the pictures, s of a solution that lasts from ``first`` to ``last``.

        ``telling`` is that of a single picture by default. Raises `InputError` for times outside.
        """
        allowed = f"allowed: {first:g} to {last:g} s"
        margin = 1e-9 * max(abs(first), abs(last), last - first)
        for name, value in (("time", self.time), ("start", self.start), ("end", self.end)):
            if value is not None and not first - margin <= value <= last + margin:
                raise InputError(f"{name} {value:g} s is outside the motion", allowed)
        start = first if self.start is None else self.start
        end = last if self.end is None else self.end
        if not self.is_video and self.strip is None:
            return np.array([telling if self.time is None else self.time])
        if not start < end:
            raise InputError(f"start {start:g} s is not before end {end:g} s", allowed)
        return np.linspace(start, end, self.strip) if self.strip else self._even_times(start, end)

    def _even_times(self, start: float, end: float) -> np.ndarray:
        """Picture k is at start + k speed / rate; the last one is at the end, maybe after a shorter step."""
        step = self.speed / float(self.rate)
        count = math.floor((end - start) / step + SAME_TIME)
        if count >= MOST_PICTURES:
            raise InputError(f"a video of {count + 1} pictures", f"allowed: {MOST_PICTURES}; lower fps")
        times = start + step * np.arange(count + 1)
        if end - times[-1] > SAME_TIME * step:
            return np.append(times, end)
        times[-1] = end
        return times

    def _check_use(self) -> None:
        """Check that every given value applies to this kind of file."""
        one_picture = not self.is_video and self.strip is None
        unused = {
            "fps": self.fps is not None and not self.is_video,
            "speed": self.speed != 1 and not self.is_video,
            "time": self.time is not None and not one_picture,
            "strip": self.strip is not None and self.is_video,
            "start": self.start is not None and one_picture,
            "end": self.end is not None and one_picture,
        }
        still = "a strip" if self.strip is not None else "a .png of one picture"
        what = f"a {self.ending}" if self.is_video else still
        for name, given in unused.items():
            if given:
                raise InputError(f"{name} has no use for {what}", f"allowed: with {USES[name]}")

    def _check_size(self) -> None:
        width, height = self.pixels
        allowed = f"allowed: WIDTHxHEIGHT, each {LEAST_SIDE} to {MOST_SIDE} pixels, as in 1280x720"
        if not (LEAST_SIDE <= width <= MOST_SIDE and LEAST_SIDE <= height <= MOST_SIDE):
            raise InputError(f"size is {width}x{height}", allowed)
        if self.ending == ".mp4" and (width % 2 or height % 2):
            even = f"{width + width % 2}x{height + height % 2}"
            raise InputError(f"size is {width}x{height}", f"a .mp4 needs even numbers, as in {even}")
        if self.canvas[0] > MOST_WIDTH:
            wide = f"{self.strip} pictures of {width} pixels side by side"
            raise InputError(wide, f"allowed: {MOST_WIDTH} pixels")


def representative_time(solution: Solution) -> float:
    """Return the middle of the first flight that follows a contact, s; of the motion if there is none."""
    start, end = solution.t[0], solution.t[-1]
    for before, rows in itertools.pairwise(solution.phases):
        touched, touches = (solution.active[part.start : part.stop].any() for part in (before, rows))
        if touched and not touches:
            start, end = solution.t[rows.start], solution.t[rows.stop - 1]
            break
    return float(start + end) / 2


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
    shots = Shots(ending=target.suffix.lower(), **options)
    if not several:
        raise InputError("there is nothing to render", "one or more solutions")
    first, last = min(float(s.t[0]) for s in several), max(float(s.t[-1]) for s in several)
    times = shots.times(first, last, representative_time(several[0]))
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
            pictures = _pictures(view, times, progress)
            if shots.is_video:
                video.write_video(unfinished, shots.ending, pictures, shots.rate)
            else:
                _write_strip(unfinished, shots, times, pictures)
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
