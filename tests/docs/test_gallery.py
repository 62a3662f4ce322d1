"""The gallery: pictures and videos that show solutions, small, and the page that lists them."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

import trajopt
from scripts import gallery, gallery_videos
from tests.support.browser import require_chromium, running_chromium
from tests.support.problems import hop
from tests.support.repository import ROOT
from tests.support.solved_problems import motion
from trajopt import InputError, Solution, simulate
from trajopt.motion.description import PeriodicImage
from trajopt_library import problems

GALLERY = ROOT / "docs" / "gallery"
# Bytes of all committed pictures: a clone stays small.
LARGEST = 2_000_000
# Grey values of a picture without content vary less than this.
BLANK = 5.0


@pytest.fixture(scope="module")
def leap() -> Solution:
    return trajopt.solve(hop(), intervals=12)


@pytest.fixture(scope="module")
def arm() -> Solution:
    return trajopt.solve(problems.load("arm-reach", robot="ur5"), intervals=6)


@pytest.fixture
def folder(tmp_path: Path, leap: Solution, arm: Solution) -> Path:
    """Solutions as ``trajopt suite --output-dir`` writes them."""
    for name, solution in (("quadruped-jump-up@mine", leap), ("arm-reach@ur5", arm)):
        solution.save(tmp_path / f"{name}.npz")
    return tmp_path


def test_a_problem_is_shown_on_one_robot_and_robots_take_turns(tmp_path: Path) -> None:
    for name in ("a@x", "a@y", "b@x", "c@x", "c@y", "c@z"):
        (tmp_path / f"{name}.npz").touch()
    assert [path.stem for path in gallery.chosen(tmp_path)] == ["a@y", "b@x", "c@z"]


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="PROBLEM@ROBOT"):
        gallery.chosen(tmp_path)


def test_a_leap_is_shown_around_its_flight(leap: Solution) -> None:
    flying = ~leap.active.any(axis=1)
    first, last = leap.t[flying][[0, -1]]
    times = gallery.times_of(leap)
    assert np.count_nonzero((times > first) & (times < last)) == gallery.PICTURES - 2
    assert times[gallery.PICTURES // 2] == pytest.approx((first + last) / 2)
    assert np.all((times >= leap.t[0]) & (times <= leap.t[-1]))


def test_what_does_not_leap_is_shown_whole(arm: Solution, leap: Solution) -> None:
    image = PeriodicImage(index=np.arange(leap.model.nv), sign=np.ones(leap.model.nv), origin=np.zeros(3))
    cycle = leap.with_description(periodicity=image)
    for solution in (arm, cycle):
        assert gallery.times_of(solution)[[0, -1]] == pytest.approx(solution.t[[0, -1]])


@pytest.mark.parametrize(
    ("problem", "title"),
    [
        ("arm-reach", "Arms"),
        ("quadruped-backflip", "Jumps and flips"),
        ("solo12-jump", "Jumps and flips"),
        ("quadruped-stairs", "Terrain"),
        ("solo12-slope", "Terrain"),
        ("quadruped-trot", "Gaits"),
        ("talos-wall", "Bipeds"),
        ("humanoid-climb", "Bipeds"),
        ("quadrotor-flip", "Multirotors"),
        ("acrobot", "Hoppers and classics"),
    ],
)
def test_problems_have_their_chapter(problem: str, title: str, arm: Solution) -> None:
    assert gallery.GROUPS[gallery.entry_of(f"{problem}@mine", arm).group][0] == title


@pytest.mark.parametrize(
    ("length", "cameras", "expected"),
    [
        (5.0, ("overview", "follow"), "follow"),
        (1.2, ("overview", "follow"), "overview"),
        (5.0, ("overview",), "overview"),
    ],
)
def test_pictures_are_framed_on_the_robot(length: float, cameras: tuple[str, ...], expected: str) -> None:
    facts = {"box": [[0.0, 0.0, 0.0], [length, 0.5, 0.5]], "size": 1.0}
    assert gallery.camera_of(facts, cameras) == expected
    assert gallery.zoom_of(facts) > 1


def test_pictures_of_what_is_tall_show_its_head() -> None:
    assert gallery.zoom_of({"box": [[0.0, 0.0, 0.0], [0.5, 0.5, 1.3]], "size": 1.3}) == 1


def test_a_picture_is_packed_into_its_size() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (gallery.HEIGHT, 5 * gallery.WIDTH, 3), dtype=np.uint8)
    smooth = Image.fromarray(noise).resize((10, 4)).resize((5 * gallery.WIDTH, gallery.HEIGHT))
    data = gallery.packed(smooth)
    assert len(data) <= gallery.MOST_BYTES
    assert Image.open(io.BytesIO(data)).size == smooth.size


@pytest.mark.long
def test_gallery_of_two_solutions(folder: Path, tmp_path: Path) -> None:
    require_chromium()
    target = tmp_path / "gallery"
    entries = gallery.make(folder, target, pages=True)
    assert [entry.name for entry in entries] == ["arm-reach@ur5", "quadruped-jump-up@mine"]
    for entry in entries:
        data = (target / f"{entry.name}.webp").read_bytes()
        assert len(data) <= gallery.MOST_BYTES
        picture = np.asarray(Image.open(io.BytesIO(data)).convert("L"), dtype=float)
        assert picture.shape == (gallery.HEIGHT, gallery.WIDTH * gallery.PICTURES)
        assert picture.std() > BLANK
        first, last = picture[:, : gallery.WIDTH], picture[:, -gallery.WIDTH :]
        assert np.abs(first - last).max() > BLANK, "the robot moves"
        assert (target / f"{entry.name}.html").is_file()
    index, readme = (target / "index.html").read_text(), (target / "README.md").read_text()
    assert all(f'href="{entry.name}.html"' in index for entry in entries)
    assert "`trajopt solve arm-reach --set robot=ur5`" in readme
    assert "## [Arms]" in readme


def test_committed_gallery_is_whole_and_small() -> None:
    text = (GALLERY / "README.md").read_text(encoding="utf-8")
    pictures = set(re.findall(r"\]\(([^)]+\.webp)\)", text))
    assert pictures == {path.relative_to(GALLERY).as_posix() for path in GALLERY.rglob("*.webp")}
    assert len(pictures) >= 25
    for path in GALLERY.glob("*.webp"):
        with Image.open(path) as picture:
            assert picture.size == (gallery.PICTURES * gallery.WIDTH, gallery.HEIGHT), path.name
    sizes = [path.stat().st_size for path in GALLERY.rglob("*.webp")]
    assert max(sizes) <= gallery.MOST_BYTES
    assert sum(sizes) <= LARGEST
    assert all((GALLERY / link).exists() for link in re.findall(r"\]\((\.\./[^)#]+)\)", text))


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
def tracked_leap() -> Solution:
    return motion("solo12-jump")


@pytest.mark.long
def test_a_part_of_a_simulation_is_a_solution_with_the_same_motion(
    tracked_leap: Solution, tmp_path: Path
) -> None:
    whole = simulate(tracked_leap, controller="whole-body").as_solution()
    begin = 0.5 * float(whole.t[-1])
    part = gallery_videos.from_time(whole, begin)
    assert 0 <= part.t[0] - begin < np.diff(whole.interval_t).max()
    later = whole.t >= part.t[0]
    assert_allclose(part.q[-later.sum() + 1 :], whole.q[later][1:])
    assert part.phase_names == whole.phase_names[-len(part.phases) :]
    loaded = Solution.load(replace(part).save(tmp_path / "part.npz"))
    assert loaded.asked_force is not None


@pytest.mark.slow
def test_a_tracked_plan_is_shown_and_one_that_is_not_is_left_out(
    tracked_leap: Solution, tmp_path: Path
) -> None:
    require_chromium()
    path = tracked_leap.save(tmp_path / "quadruped-jump-up@mine.npz")
    with running_chromium() as browser:
        found = gallery_videos.video_of(browser, path, 1)
        assert found is not None
        assert len(found.pictures) == gallery_videos.PICTURES
        assert found.duration == pytest.approx(float(tracked_leap.t[-1]), abs=2e-3)
        first, middle = (
            np.asarray(found.pictures[k].convert("L"), dtype=float) for k in (0, gallery_videos.PICTURES // 2)
        )
        assert first.shape == (SIDE, SIDE)
        assert np.abs(first - middle).max() > MOVED
        far = replace(
            tracked_leap,
            q=tracked_leap.q
            + np.eye(tracked_leap.model.nq)[0] * np.linspace(0, 3, tracked_leap.n_samples)[:, None],
        )
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
