"""Videos of the gallery: simulated motions that are tracked, small, and their part of the page."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from scripts import gallery, gallery_videos
from tests.support.browser import require_chromium, running_chromium
from tests.support.repository import ROOT
from tests.support.solved_problems import motion
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.simulation.simulate import simulate

GALLERY = ROOT / "docs" / "gallery"
# Grey values of two pictures differ by more than this where the robot moved.
MOVED = 5.0
SIDE = gallery_videos.SIDE


def picture(shade: int) -> Image.Image:
    return Image.new("RGB", (SIDE, SIDE), (shade, 100, 200))


def video(name: str = "quadruped-trot@go2", cycles: int = 10) -> gallery_videos.Video:
    shades = tuple(picture(20 * k) for k in range(3))
    return gallery_videos.Video(name=name, cycles=cycles, base_error=2e-3, duration=0.3, pictures=shades)


def test_several_pictures_are_packed_as_a_video_that_repeats() -> None:
    first, *others = video().pictures
    data = gallery.packed(first, others, 0.1)
    with Image.open(io.BytesIO(data)) as found:
        assert (found.size, found.n_frames, found.info["loop"]) == ((SIDE, SIDE), 3, 0)
        found.seek(2)
        found.load()
        assert found.info["duration"] == 100
    assert len(data) <= gallery.MOST_BYTES


def test_files_of_the_suite_are_shown_that_are_there(tmp_path: Path) -> None:
    for name in ("biped-run@g1", "biped-run@talos", "hopper-hop@hopper_space"):
        (tmp_path / f"{name}.npz").touch()
    found = gallery_videos.chosen(tmp_path)
    assert {path.stem: cycles for path, cycles in found.items()} == {
        "hopper-hop@hopper_space": 1,
        "biped-run@g1": 10,
    }


def test_the_page_says_how_a_video_is_made_and_keeps_one_part_for_them() -> None:
    text = gallery_videos.with_section("# Gallery\n", [video()])
    assert text.startswith("# Gallery\n\n## Tracked in MuJoCo\n")
    assert "![quadruped-trot on go2, tracked](tracked/quadruped-trot@go2.webp)" in text
    command = "trajopt simulate plan.npz --cycles 10 --controller whole-body"
    assert f"`trajopt solve quadruped-trot --set robot=go2 --output plan.npz; {command}" in text
    again = gallery_videos.with_section(text, [video("biped-run@g1")])
    assert again.count(gallery_videos.HEADING) == 1
    assert "quadruped-trot" not in again
    assert gallery_videos.with_section(again, []) == "# Gallery\n"


def test_videos_need_a_gallery_to_which_they_belong(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no README\.md"):
        gallery.make_videos(tmp_path, tmp_path)


@pytest.fixture(scope="module")
def leap() -> Solution:
    return motion("solo12-jump")


@pytest.mark.long
def test_a_part_of_a_simulation_is_a_solution_with_the_same_motion(leap: Solution, tmp_path: Path) -> None:
    whole = simulate(leap, controller="whole-body").as_solution()
    begin = 0.5 * float(whole.t[-1])
    part = gallery_videos.from_time(whole, begin)
    assert 0 <= part.t[0] - begin < np.diff(whole.interval_t).max()
    later = whole.t >= part.t[0]
    assert_allclose(part.q[-later.sum() + 1 :], whole.q[later][1:])
    assert part.phase_names == whole.phase_names[-len(part.phases) :]
    loaded = Solution.load(replace(part).save(tmp_path / "part.npz"))
    assert loaded.asked_force is not None


@pytest.mark.slow
def test_a_tracked_plan_is_shown_and_one_that_is_not_is_left_out(leap: Solution, tmp_path: Path) -> None:
    require_chromium()
    path = leap.save(tmp_path / "quadruped-jump-up@mine.npz")
    with running_chromium() as browser:
        found = gallery_videos.video_of(browser, path, 1)
        assert found is not None
        assert len(found.pictures) == gallery_videos.PICTURES
        assert found.duration == pytest.approx(float(leap.t[-1]), abs=2e-3)
        first, middle = (
            np.asarray(found.pictures[k].convert("L"), dtype=float) for k in (0, gallery_videos.PICTURES // 2)
        )
        assert first.shape == (SIDE, SIDE)
        assert np.abs(first - middle).max() > MOVED
        far = replace(leap, q=leap.q + np.eye(leap.model.nq)[0] * np.linspace(0, 3, leap.n_samples)[:, None])
        far.save(path)
        assert gallery_videos.video_of(browser, path, 1) is None


def test_committed_videos_move_and_repeat() -> None:
    text = (GALLERY / "README.md").read_text(encoding="utf-8")
    names = re.findall(rf"\]\({gallery_videos.FOLDER}/([^)]+)\.webp\)", text)
    assert names == list(gallery_videos.TRACKED)
    for name in names:
        with Image.open(GALLERY / gallery_videos.FOLDER / f"{name}.webp") as found:
            assert found.size == (SIDE, SIDE)
            assert (found.n_frames, found.info["loop"]) == (gallery_videos.PICTURES, 0)
