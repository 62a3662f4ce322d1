"""The pictures of a rendering: kind of file, sizes and times, validated together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from trajopt.errors import InputError, is_number
from trajopt.solution.solution import Solution
from trajopt.view.replay.motion import require_speed

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

# What options are for that do not apply to every kind of file.
USES = {
    **dict.fromkeys(("--fps", "--speed"), "a video"),
    "--time": "a .png of one picture, which is without --strip",
    "--strip": "a .png",
    **dict.fromkeys(("--from", "--to"), "a video, or a .png with --strip"),
}


@dataclass(frozen=True, kw_only=True)
class Shots:
    """Pictures of a replay for one file.

    ending: suffix, one of `SIZES`. size: pixels (width, height), of each picture of a strip; default by
    suffix. fps: pictures a second of a video. speed: seconds of the motion a second of video.
    start, end: s of the solution; the whole motion if not given. time: s, of a .png. strip: a .png of so many
    pictures side by side, from start to end. camera: one of the page's. caption: text. hidden, shown: names
    of layers.

    Raises `InputError`, one line, for values out of range and for those that do not fit together.
    """

    ending: str
    size: tuple[int, int] | None = None
    fps: float | None = None
    speed: float = 1.0
    start: float | None = None
    end: float | None = None
    time: float | None = None
    strip: int | None = None
    camera: str | None = None
    caption: bool = True
    hidden: Sequence[str] = ()
    shown: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.ending not in SIZES:
            name = f"'{self.ending}'" if self.ending else "missing"
            raise InputError(f"the ending of the output is {name}", "allowed: " + ", ".join(SIZES))
        self._check_numbers()
        self._check_use()
        self._check_size()
        most = MOST_RATE.get(self.ending)
        if self.fps is not None and most is not None and not 1 <= self.fps <= most:
            raise InputError(f"--fps is {self.fps:g}", f"allowed for a {self.ending}: 1 to {most:g}")

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

        telling: time of a single picture if none is given. Raises `InputError` for times outside.
        """
        allowed = f"allowed: {first:g} to {last:g} s"
        margin = 1e-9 * max(abs(first), abs(last), last - first)
        for name, value in (("--time", self.time), ("--from", self.start), ("--to", self.end)):
            if value is not None and not first - margin <= value <= last + margin:
                raise InputError(f"{name} {value:g} s is outside the motion", allowed)
        start = first if self.start is None else self.start
        end = last if self.end is None else self.end
        if not self.is_video and self.strip is None:
            return np.array([telling if self.time is None else self.time])
        if not start < end:
            raise InputError(f"--from {start:g} s is not before --to {end:g} s", allowed)
        return np.linspace(start, end, self.strip) if self.strip else self._even_times(start, end)

    def _even_times(self, start: float, end: float) -> np.ndarray:
        """Picture k at start + k speed / rate; the last one is at the end, which may be a shorter step."""
        step = self.speed / float(self.rate)
        count = math.floor((end - start) / step + SAME_TIME)
        if count >= MOST_PICTURES:
            raise InputError(f"a video of {count + 1} pictures", f"allowed: {MOST_PICTURES}; lower --fps")
        times = start + step * np.arange(count + 1)
        if end - times[-1] > SAME_TIME * step:
            return np.append(times, end)
        times[-1] = end
        return times

    def _check_numbers(self) -> None:
        """Check the types of numbers: a script may pass anything."""
        require_speed(self.speed)
        named = {"--fps": self.fps, "start": self.start, "end": self.end, "time": self.time}
        for name, value in named.items():
            if value is not None and not is_number(value):
                raise InputError(f"{name} is {value!r}", "allowed: a finite number")
        if self.strip is not None and not (isinstance(self.strip, int) and 2 <= self.strip <= MOST_STRIP):
            raise InputError(f"a strip of {self.strip!r} pictures", f"allowed: 2 to {MOST_STRIP}")

    def _check_use(self) -> None:
        """Check that every given value applies to this kind of file."""
        one_picture = not self.is_video and self.strip is None
        unused = {
            "--fps": self.fps is not None and not self.is_video,
            "--speed": self.speed != 1 and not self.is_video,
            "--time": self.time is not None and not one_picture,
            "--strip": self.strip is not None and self.is_video,
            "--from": self.start is not None and one_picture,
            "--to": self.end is not None and one_picture,
        }
        what = "a .png of one picture" if one_picture else f"a {self.ending}"
        if self.strip is not None and not self.is_video:
            what = "a strip"
        for name, given in unused.items():
            if given:
                raise InputError(f"{name} has no use for {what}", f"allowed: with {USES[name]}")

    def _check_size(self) -> None:
        pair = isinstance(self.pixels, Sequence) and len(self.pixels) == 2
        if not pair or not all(isinstance(side, int) for side in self.pixels):
            raise InputError(f"size is {self.size!r}", "allowed: (width, height) in whole pixels")
        width, height = self.pixels
        allowed = f"allowed: WIDTHxHEIGHT, each {LEAST_SIDE} to {MOST_SIDE} pixels, as in 1280x720"
        if not (LEAST_SIDE <= width <= MOST_SIDE and LEAST_SIDE <= height <= MOST_SIDE):
            raise InputError(f"--size is {width}x{height}", allowed)
        if self.ending == ".mp4" and (width % 2 or height % 2):
            even = f"{width + width % 2}x{height + height % 2}"
            raise InputError(f"--size is {width}x{height}", f"a .mp4 needs even numbers, as in {even}")
        if self.canvas[0] > MOST_WIDTH:
            raise InputError(
                f"{self.strip} pictures of {width} pixels side by side", f"allowed: {MOST_WIDTH} pixels"
            )


def representative_time(solution: Solution) -> float:
    """Return the middle of the first flight that follows a contact, s; of the motion if there is none."""
    touches = [bool(solution.active[rows.start : rows.stop].any()) for rows in solution.phases]
    for number in range(1, len(touches)):
        if touches[number - 1] and not touches[number]:
            rows = solution.phases[number]
            return float(solution.t[rows.start] + solution.t[rows.stop - 1]) / 2
    return float(solution.t[0] + solution.t[-1]) / 2
