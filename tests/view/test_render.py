"""Videos, GIFs, pictures: exact frames and durations, as the page shows them; bad input; all or nothing."""

import io
import os
import re
import sys
import uuid
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from PIL import Image

from tests.support.browser import in_motion, require_chromium
from tests.support.command_lines import assert_refused, invoke
from tests.support.processes import TRAJOPT, Running, needs_proc, processes, run, until
from tests.support.synthetic_motions import arm_motion, sampled
from trajopt import InputError, Solution, TrajoptError, replay
from trajopt.view.replay import video
from trajopt.view.replay.browser import open_page
from trajopt.view.replay.render import GAP, MOST_PICTURES, Shots, render, representative_time
from trajopt_library import robots

SMALL = (96, 64)
RATE = Fraction(25)
# Levels of 255 by which H.264 at its constant quality may be off on average, 4:2:0 of flat colours included.
COLOUR_LOSS = 3.0
# Levels of 255 by which a palette of 255 colours and its dither may be off on average.
PALETTE_LOSS = 6.0


@pytest.fixture(scope="module")
def hop() -> Solution:
    return in_motion(robots.load("hopper"))


@pytest.fixture(scope="module")
def hop_file(hop, tmp_path_factory) -> Path:
    return hop.save(tmp_path_factory.mktemp("solutions") / "hop.npz")


@pytest.fixture(scope="module")
def chromium_is_here():
    require_chromium()


def png(picture: np.ndarray) -> bytes:
    held = io.BytesIO()
    Image.fromarray(picture).save(held, format="PNG")
    return held.getvalue()


def moving_square(count: int) -> list[np.ndarray]:
    """Pictures (64, 96, 3) of a coloured square that goes to the right."""
    pictures = []
    for k in range(count):
        picture = np.full((SMALL[1], SMALL[0], 3), (190, 205, 230), dtype=np.uint8)
        picture[16:48, 4 + 4 * k : 24 + 4 * k] = (200, 60, 30)
        pictures.append(picture)
    return pictures


def said_by_ffmpeg(path: Path) -> str:
    return run(video.find_ffmpeg(), "-i", path).stderr


def frames_of(path: Path, size: tuple[int, int]) -> np.ndarray:
    command = (video.find_ffmpeg(), "-loglevel", "error", "-i", path, "-f", "rawvideo")
    done = run(*command, "-pix_fmt", "rgb24", "-", text=False)
    assert done.returncode == 0, done.stderr
    return np.frombuffer(done.stdout, np.uint8).reshape(-1, size[1], size[0], 3)


def gif_frames(path: Path) -> tuple[np.ndarray, list[int], int]:
    """Pictures, how long each is shown (ms), and how often it repeats (0: for ever)."""
    with Image.open(path) as gif:
        pictures, times = [], []
        for number in range(gif.n_frames):
            gif.seek(number)
            pictures.append(np.array(gif.convert("RGB")))
            times.append(gif.info["duration"])
        return np.array(pictures), times, gif.info["loop"]


def loss(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found.astype(float) - expected).mean())


def test_mp4_has_every_picture_for_its_time_in_its_colours(tmp_path):
    pictures = moving_square(12)
    video.write_video(tmp_path / "a.mp4", ".mp4", map(png, pictures), RATE)
    said = said_by_ffmpeg(tmp_path / "a.mp4")
    assert "h264" in said
    assert re.search(r"yuv420p\(tv, bt709", said)
    assert "25 fps" in said
    assert "Duration: 00:00:00.48" in said
    found = frames_of(tmp_path / "a.mp4", SMALL)
    assert len(found) == len(pictures)
    for frame, picture in zip(found, pictures, strict=True):
        assert loss(frame, picture) < COLOUR_LOSS


@pytest.mark.parametrize("rate", [Fraction(25), Fraction(30), Fraction(15)])
def test_gif_has_every_picture_for_its_time_and_repeats(tmp_path, rate):
    pictures = moving_square(12)
    video.write_video(tmp_path / "a.gif", ".gif", map(png, pictures), rate)
    found, times, loop = gif_frames(tmp_path / "a.gif")
    assert len(found) == len(pictures)
    assert loop == 0
    assert abs(sum(times) - 1000 * len(pictures) / rate) <= 10  # ms: whole hundredths of a second
    for frame, picture in zip(found, pictures, strict=True):
        assert loss(frame, picture) < PALETTE_LOSS


def test_webp_has_every_picture_for_its_time_and_repeats(tmp_path):
    pictures = moving_square(12)
    video.write_video(tmp_path / "a.webp", ".webp", map(png, pictures), RATE)
    with Image.open(tmp_path / "a.webp") as found:
        assert found.n_frames == len(pictures)
        assert found.info["loop"] == 0
        times = []
        for number, picture in enumerate(pictures):
            found.seek(number)
            assert loss(np.array(found.convert("RGB")), picture) < COLOUR_LOSS
            times.append(found.info["duration"])
    assert times == [40] * len(pictures)


def test_error_of_ffmpeg_is_one_line_and_of_the_pictures_goes_through(tmp_path):
    with pytest.raises(TrajoptError, match="ffmpeg cannot write the file: ") as raised:
        video.write_video(tmp_path / "none" / "a.mp4", ".mp4", map(png, moving_square(2)), RATE)
    assert "\n" not in str(raised.value)

    def failing():
        yield png(moving_square(1)[0])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        video.write_video(tmp_path / "a.mp4", ".mp4", failing(), RATE)


def test_times_of_a_video_are_even_and_end_with_the_motion():
    times = Shots(ending=".mp4", fps=30.0).times(0.1, 1.3, 0.0)
    np.testing.assert_allclose(times, 0.1 + np.arange(37) / 30)
    uneven = Shots(ending=".mp4", fps=25.0, speed=0.5, start=0.2, end=0.55).times(0.0, 1.0, 0.0)
    np.testing.assert_allclose(uneven, [*(0.2 + 0.02 * np.arange(18)), 0.55])
    np.testing.assert_allclose(Shots(ending=".png", strip=3).times(1.0, 2.0, 0.0), [1.0, 1.5, 2.0])
    assert Shots(ending=".png").times(0.0, 1.0, 0.7) == [0.7]
    assert Shots(ending=".png", time=0.25).times(0.0, 1.0, 0.7) == [0.25]


def test_telling_moment_is_the_middle_of_the_first_flight_after_a_contact():
    robot = robots.load("ur5")
    arm = sampled(robot, [arm_motion(robot, duration=0.8)], 4)
    assert representative_time(arm) == pytest.approx(0.4)
    hop = in_motion(robots.load("hopper"))
    stance, flight = hop.phases
    assert representative_time(hop) == pytest.approx((hop.t[flight.start] + hop.t[flight.stop - 1]) / 2)
    assert hop.active[stance.start].any()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"ending": ".avi"}, r"ending of the output is '.avi'; allowed: .mp4, .webp, .gif, .png"),
        ({"ending": ""}, "ending of the output is missing"),
        ({"ending": ".mp4", "size": (641, 360)}, "641x360; a .mp4 needs even numbers, as in 642x360"),
        ({"ending": ".gif", "size": (0, 360)}, "size is 0x360; allowed: WIDTHxHEIGHT, each 64 to 4096"),
        ({"ending": ".png", "size": (-640, 360)}, "size is -640x360"),
        ({"ending": ".mp4", "size": (100_000, 100_000)}, "size is 100000x100000"),
        ({"ending": ".png", "strip": 32, "size": (2000, 100)}, "side by side"),
        ({"ending": ".png", "strip": 1}, "strip of Shots is 1; allowed: a whole number from 2 to 32"),
        ({"ending": ".mp4", "strip": 3}, "strip has no use for a .mp4"),
        ({"ending": ".png", "fps": 30.0}, "fps has no use for a .png"),
        ({"ending": ".png", "start": 0.1}, "start has no use for a .png of one picture"),
        ({"ending": ".gif", "time": 0.1}, "time has no use for a .gif"),
        (
            {"ending": ".png", "strip": 3, "time": 0.5},
            "time has no use for a strip; allowed: with a .png of one",
        ),
        ({"ending": ".gif", "fps": 60.0}, "fps is 60; allowed for a .gif: 1 to 50"),
        ({"ending": ".mp4", "fps": 0.0}, "fps is 0"),
        ({"ending": ".mp4", "fps": float("nan")}, "fps of Shots is nan"),
        ({"ending": ".mp4", "speed": 0.0}, "speed of Shots is 0.0; allowed: a finite number from 0 to 1000"),
        ({"ending": ".mp4", "speed": float("inf")}, "speed of Shots is inf"),
        ({"ending": ".png", "time": float("nan")}, "time of Shots is nan"),
    ],
)
def test_values_that_make_no_file_are_refused_in_one_line(options, told):
    with pytest.raises(InputError, match=re.escape(told) if "\\" not in told else told) as raised:
        Shots(**options)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"ending": ".png", "time": 1.5}, "time 1.5 s is outside the motion; allowed: 0.2 to 1.2 s"),
        ({"ending": ".mp4", "start": -0.1}, "start -0.1 s is outside the motion"),
        ({"ending": ".gif", "end": 1.3}, "end 1.3 s is outside the motion"),
        ({"ending": ".mp4", "start": 0.9, "end": 0.9}, "start 0.9 s is not before end 0.9 s"),
        ({"ending": ".mp4", "speed": 1e-9}, f"allowed: {MOST_PICTURES}"),
    ],
)
def test_times_outside_the_motion_are_refused_in_one_line(options, told):
    with pytest.raises(InputError, match=re.escape(told)):
        Shots(**options).times(0.2, 1.2, 0.5)


def command(*arguments: object) -> Result:
    return invoke("render", *arguments)


def test_bad_input_is_one_line_and_writes_nothing(hop_file, tmp_path, monkeypatch):
    there = tmp_path / "a.mp4"
    assert_refused(command(hop_file, "-o", tmp_path / "a.avi"), "'.avi'", ".mp4, .webp, .gif, .png")
    assert_refused(command(hop_file, "-o", there, "--size", "big"), "'big'", "1280x720")
    assert_refused(command(hop_file, "-o", there, "--size", "-4x8"), "'-4x8'")
    assert_refused(command(hop_file, "-o", tmp_path / "no" / "a.mp4"), "no does not exist")
    (tmp_path / "folder.png").mkdir()
    assert_refused(command(hop_file, "-o", tmp_path / "folder.png"), "it is a folder")
    assert_refused(command(hop_file, "-o", there, "--from", 2, "--to", 3), "outside the motion", "0 to 0.7 s")
    assert_refused(command(tmp_path / "none.npz", "-o", there), "none.npz")
    assert_refused(command(hop_file, hop_file, "-o", there, "--label", "one"), "1 labels")
    assert_refused(command("-o", there), "FILE")
    assert_refused(command(hop_file), "--output")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert_refused(command(hop_file, "-o", there), "pip install imageio-ffmpeg")
    monkeypatch.setitem(sys.modules, "playwright.async_api", None)
    assert_refused(command(hop_file, "-o", tmp_path / "a.png"), "pip install playwright")
    monkeypatch.undo()
    monkeypatch.setenv("TRAJOPT_CHROMIUM", "/nowhere/chromium")
    assert_refused(command(hop_file, "-o", there), "/nowhere/chromium", "apt install chromium")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


@pytest.mark.long
def test_unknown_camera_is_refused_with_those_there_are(chromium_is_here, hop_file, tmp_path):
    result = command(hop_file, "-o", tmp_path / "a.png", "--camera", "behind")
    assert result.exit_code == 2
    told = result.stderr.strip().splitlines()[-1]  # after the note that this robot is drawn as a skeleton
    assert told.startswith("trajopt: camera 'behind' is unknown; allowed: overview, follow, side")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_pictures_of_a_video_are_those_of_the_page(chromium_is_here, hop, hop_file, tmp_path):
    out, page = tmp_path / "hop.mp4", tmp_path / "page.html"
    result = command(
        hop_file,
        "-o",
        out,
        "--size",
        "160x96",
        "--fps",
        10,
        "--camera",
        "side",
        "--from",
        0.2,
        "--no-caption",
    )
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{out}: 6 pictures, 0.60 s, 160x96, {out.stat().st_size / 1e6:.1f} MB\n"
    frames = frames_of(out, (160, 96))
    assert len(frames) == 6
    replay(hop, html=page)
    with open_page(page, (160, 96), "t=0&bare") as view:
        view.camera("side")
        for k in (0, 2, 5):
            view.seek(0.2 + 0.1 * k)
            expected = view.picture()
            assert loss(frames[k], expected) < COLOUR_LOSS
    assert loss(frames[0], frames[4]) > 0.1  # it moves


@pytest.mark.long
def test_gif_and_picture_and_strip_of_a_solution(chromium_is_here, hop, tmp_path):
    told: list[tuple[int, int]] = []
    made = render(
        hop, tmp_path / "a.gif", size=(128, 96), fps=10.0, progress=lambda *count: told.append(count)
    )
    pictures, times, loop = gif_frames(made.path)
    assert (len(pictures), loop) == (8, 0) == (made.pictures, loop)
    assert sum(times) == 800 == 1000 * made.duration
    assert told == [(k + 1, 8) for k in range(8)]
    still = render(hop, tmp_path / "a.png", size=(161, 97))
    with Image.open(still.path) as picture:
        assert (picture.size, picture.format, picture.mode) == ((161, 97), "PNG", "RGB")
        assert np.array(picture).std() > 10
    assert still.duration == 0
    assert still.size == still.path.stat().st_size
    strip = render([hop, hop], tmp_path / "s.png", strip=3, size=(96, 96), layout="side-by-side")
    with Image.open(strip.path) as picture:
        assert picture.size == (3 * 96 + 2 * GAP, 96) == (strip.width, strip.height)
        parts = [np.array(picture)[:, start : start + 96] for start in (0, 96 + GAP, 192 + 2 * GAP)]
        assert not np.array_equal(parts[0], parts[1])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.png", "s.png"]


@pytest.mark.long
@needs_proc
def test_ctrl_c_ends_everything_and_leaves_the_old_file(chromium_is_here, hop_file, tmp_path):
    marker, out = uuid.uuid4().hex, tmp_path / "a.mp4"
    out.write_text("old")
    command = (*TRAJOPT, "render", hop_file, "-o", out, "--speed", "0.001")
    with Running(*command, env={**os.environ, "MARKER": marker}) as process:
        assert until(
            lambda: (
                any(path.stat().st_size for path in tmp_path.glob(".a.mp4.*/a.mp4"))
                or process.popen.poll() is not None
            )
        )
        process.press()
        status, _, said = process.finish()
    assert status == 130
    assert said.splitlines()[1:] == ["trajopt: cancelled"]  # after the note on the skeleton
    assert until(lambda: not processes(marker))
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.mp4", "old")]
