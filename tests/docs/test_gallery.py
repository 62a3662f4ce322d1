"""The gallery: pictures of solutions that show them, small, and the page that lists them."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import trajopt
from scripts import gallery
from tests.support.browser import require_chromium
from tests.support.problems import hop
from tests.support.repository import ROOT
from trajopt.errors import InputError
from trajopt.motion.description import PeriodicImage
from trajopt.motion.solution import Solution
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
