"""Exports by name: what is known, what is refused, and that a file or folder is complete or as it was."""

from pathlib import Path

import numpy as np
import pytest

import trajopt
from tests.support.exported_plans import plan_to_export
from tests.support.refusals import assert_refused_in_one_line
from tests.support.repository import ROOT
from trajopt.errors import InputError
from trajopt.export.formats import FORMATS, OPTIONS

ONE_MOTION = [name for name, each in FORMATS.items() if not each.several]
FOLDERS = [name for name, each in FORMATS.items() if not each.ending]
FILES = [name for name, each in FORMATS.items() if each.ending]


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_is_complete_and_documented(name: str) -> None:
    chosen = FORMATS[name]
    assert callable(chosen.load_writer())
    assert chosen.ending.startswith(".") or chosen.marker
    assert set(chosen.options) <= set(OPTIONS)
    assert f"`{name}`" in (ROOT / "docs/exports.md").read_text(encoding="utf-8")


def test_a_file_given_by_its_path_is_exported_and_its_path_returned(tmp_path: Path) -> None:
    file = plan_to_export("an arm").save(tmp_path / "arm.npz")
    written = trajopt.export_motion(str(file), "isaaclab-amp", str(tmp_path / "a.npz"))
    assert written == tmp_path / "a.npz"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "arm.npz"]


def test_the_plans_own_file_is_not_replaced(tmp_path: Path) -> None:
    file = plan_to_export("an arm").save(tmp_path / "arm.npz")
    words = "arm.npz is an input file; allowed: another name for the output"
    assert_refused_in_one_line(lambda: trajopt.export_motion(file, "isaaclab-amp", file), words)


@pytest.mark.parametrize("name", FILES)
def test_the_same_motion_gives_the_same_file(name: str, tmp_path: Path) -> None:
    ending, plan = FORMATS[name].ending, plan_to_export("turning trot")
    first, second = (trajopt.export_motion(plan, name, tmp_path / f"{key}{ending}") for key in "ab")
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("name", FOLDERS)
def test_the_same_motion_gives_the_same_folder(name: str, tmp_path: Path) -> None:
    found = []
    for place in ("first", "second"):
        (tmp_path / place).mkdir()
        folder = trajopt.export_motion(plan_to_export("an arm"), name, tmp_path / place / "a")
        assert (folder / FORMATS[name].marker).is_file()
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        found.append({path.relative_to(folder): path.read_bytes() for path in files})
    assert found[0] == found[1]


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_is_replaced_only_by_an_export_of_its_kind(name: str, tmp_path: Path) -> None:
    plan, target = plan_to_export("an arm"), tmp_path / "a"
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    words = "a: it is there and is no such export; allowed: another name"
    assert_refused_in_one_line(lambda: trajopt.export_motion(plan, name, target), words)
    assert [path.name for path in target.iterdir()] == ["notes.txt"]
    (target / "notes.txt").unlink()
    for rate in (20, 10):
        trajopt.export_motion(plan, name, target, rate)
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("format", "path", "settings", "words"),
    [
        ("isaaclab", "a.npz", {}, "export format 'isaaclab' is unknown; did you mean isaaclab-amp?"),
        ("isaaclab-amp", "a.json", {}, "does not end with .npz; allowed: NAME.npz"),
        ("isaaclab-amp", "no/a.npz", {}, "no does not exist"),
        (
            "isaaclab-amp",
            "a.npz",
            {"mjcf": "a.xml"},
            "mjcf is of no use for isaaclab-amp; allowed: no option",
        ),
        ("isaaclab-amp", "a.npz", {"rate": -1.0}, "rate"),
        ("isaaclab-amp", "a.npz", {"rate": "fast"}, "rate"),
        ("isaaclab-amp", "a.npz", {"cycles": 1.5}, "cycles"),
        ("isaaclab-amp", "a.npz", {"task": "walk"}, "task is of no use for isaaclab-amp; allowed: no option"),
        ("rosbag", "no/a", {}, "no does not exist"),
        ("mujoco", "a", {"cycles": 2}, "the solution is not periodic"),
        ("lerobot", "a", {"task": 3}, "task"),
        ("mjlab", "a.npz", {"mjcf": "none.xml"}, "cannot read none.xml"),
    ],
)
def test_bad_settings_are_refused_in_one_line_and_nothing_is_written(
    format: str, path: str, settings: dict[str, object], words: str, tmp_path: Path
) -> None:
    plan = plan_to_export("an arm")
    assert_refused_in_one_line(
        lambda: trajopt.export_motion(plan, format, tmp_path / path, **settings), words
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ONE_MOTION)
def test_several_motions_are_refused_where_a_format_takes_one(name: str, tmp_path: Path) -> None:
    plans = [plan_to_export("an arm")] * 2
    target = tmp_path / f"a{FORMATS[name].ending}"
    assert_refused_in_one_line(
        lambda: trajopt.export_motion(plans, name, target), f"2 motions for {name}; allowed: one"
    )
    assert_refused_in_one_line(lambda: trajopt.export_motion([], name, target), f"0 motions for {name}")


@pytest.mark.parametrize("given", [7, "none.npz", [3.0]])
def test_what_is_no_solution_is_refused_in_one_line(given: object, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        trajopt.export_motion(given, "isaaclab-amp", tmp_path / "a.npz")  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_a_motion_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    plan = plan_to_export("an arm")
    broken = plan.with_arrays(v=np.where(np.arange(plan.v.size).reshape(plan.v.shape) == 5, np.nan, plan.v))
    assert_refused_in_one_line(
        lambda: trajopt.export_motion(broken, "isaaclab-amp", tmp_path / "a.npz"), "NaN or infinity"
    )


def test_a_refused_motion_leaves_the_earlier_file(tmp_path: Path) -> None:
    target = tmp_path / "a.json"
    trajopt.export_motion(plan_to_export("turning trot"), "amp-hardware", target)
    before = target.read_bytes()
    with pytest.raises(InputError):
        trajopt.export_motion(plan_to_export("an arm"), "amp-hardware", target)
    assert target.read_bytes() == before
    assert list(tmp_path.iterdir()) == [target]
