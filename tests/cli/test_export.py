"""``trajopt export``: what it writes, and what it refuses."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.sampled_problems import solution_of_kind
from tests.support.synthetic_motions import with_meta
from trajopt.export.formats import FORMATS
from trajopt.motion.solution import Solution


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return solution_of_kind("points").save(tmp_path / "hop.npz")


def export(*words: object) -> Result:
    return invoke("export", *words)


def test_default_is_a_csv_at_500_hz_beside_where_it_is_called(plan: Path) -> None:
    result = export(plan)
    assert (result.exit_code, result.stdout) == (0, "hop-500hz.csv: 401 samples at 500 Hz\n")
    frame = pd.read_csv("hop-500hz.csv")
    np.testing.assert_allclose(np.diff(frame["t"]), 0.002, atol=1e-12)
    assert "v/base/linear_x_body" in frame


@pytest.mark.parametrize("form", ["csv", "parquet", "npz"])
def test_the_ending_chooses_the_format_and_conventions_are_chosen(plan: Path, form: str) -> None:
    words = ("--quaternion", "wxyz", "--base-velocity", "world", "--rate", 100)
    assert export(plan, "-o", f"a.{form}", *words).exit_code == 0
    assert export(plan, "--format", form, *words).exit_code == 0
    expected = Solution.load(plan).sample(100, quaternion="wxyz", base_velocity="world")
    for path in (f"a.{form}", f"hop-100hz.{form}"):
        if form == "npz":
            with np.load(path) as archive:
                np.testing.assert_array_equal(archive["q"], expected.q)
        else:
            frame = pd.read_csv(path) if form == "csv" else pd.read_parquet(path)
            assert list(frame.columns) == list(expected.columns)
            np.testing.assert_array_equal(frame["q/base/qw"], expected.q[:, 3])


def test_motion_formats_have_a_rate_and_a_name_of_their_own(plan: Path) -> None:
    result = export(plan, "--format", "isaaclab-amp")
    assert (result.exit_code, result.stdout) == (
        0, "hop-isaaclab-amp.npz: 1 motion at 50 Hz, isaaclab-amp\n",
    )  # fmt: skip
    with np.load("hop-isaaclab-amp.npz") as data:
        assert (int(data["fps"]), len(data["dof_positions"])) == (50, 41)
    assert export(plan, "--format", "isaaclab-amp", "--rate", 100, "-o", "a.npz").exit_code == 0
    with np.load("a.npz") as data:
        assert (int(data["fps"]), len(data["dof_positions"])) == (100, 81)


def test_several_files_become_one_where_the_format_takes_several(plan: Path) -> None:
    assert export(plan, "--format", "mjcf", "-o", "hop.xml").exit_code == 0
    words = ("--format", "loco-mujoco", "--mjcf", "hop.xml", "-o", "both.npz")
    result = export(plan, plan, *words)
    assert (result.exit_code, result.stdout) == (0, "both.npz: 2 motions at 50 Hz, loco-mujoco\n")
    with np.load("both.npz") as data:
        np.testing.assert_array_equal(data["split_points"], [0, 41, 82])


def test_folders_have_the_name_and_the_rate_of_their_format(plan: Path) -> None:
    for form, rate in (("lerobot", 50), ("mujoco", 500), ("rosbag", 50)):
        result = export(plan, "--format", form)
        assert (result.exit_code, result.stdout) == (0, f"hop-{form}: 1 motion at {rate} Hz, {form}\n")
        assert Path(f"hop-{form}", FORMATS[form].marker).is_file()
    result = export(plan, plan, "--format", "lerobot", "--task", "hop", "-o", "hop-lerobot")
    assert (result.exit_code, result.stdout) == (0, "hop-lerobot: 2 motions at 50 Hz, lerobot\n")
    assert list(pd.read_parquet("hop-lerobot/meta/tasks.parquet").index) == ["hop"]


def test_help_lists_the_formats() -> None:
    text = export("--help").stdout
    for name, each in FORMATS.items():
        assert f"  {name}" in text
        assert each.help in text


def test_an_earlier_export_is_replaced(plan: Path) -> None:
    Path("a.csv").write_text("old")
    assert export(plan, "-o", "a.csv").exit_code == 0
    assert Path("a.csv").read_text().startswith("t,phase,")
    assert export(plan, "-o", "a.npz").exit_code == export(plan, "-o", "a.npz").exit_code == 0


def test_mjcf_opens_in_mujoco(plan: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    assert export(plan, "--format", "mjcf").stdout == "hop.xml\n"
    assert export(plan, "-o", "b.xml").exit_code == 0
    assert Path("hop.xml").read_text() == Path("b.xml").read_text()
    assert mujoco.MjModel.from_xml_path("b.xml").nu == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--rate", 0), "rate is 0 Hz; allowed: finite and > 0"),
        (("--rate", "nan"), "rate is nan Hz"),
        (("--rate", "fast"), "'fast' is not a valid float"),
        (("--rate", "1e12"), "samples in 0.8 s; allowed: 200000"),
        (("--format", "xlsx"), "'xlsx' is not one of"),
        (("--quaternion", "xyz"), "'xyz' is not one of"),
        (("--base-velocity", "local"), "'local' is not one of"),
        (("-o", "a.txt"), "--output a.txt ends with '.txt'; allowed: .csv, .parquet, .npz, .xml"),
        (("-o", "a.npz", "--format", "csv"), "--output a.npz ends with '.npz'; allowed: .csv"),
        (("-o", "hop.npz"), "hop.npz is an input file"),
        (("-o", "other.npz"), "other.npz is a solution file; allowed: another name"),
        (("--format", "mjcf", "--rate", 100), "--rate is of no use for mjcf"),
        (("-o", "a.xml", "--base-velocity", "world"), "--base-velocity is of no use for mjcf"),
        (("-o", "a.xml", "--format", "npz"), "--output a.xml ends with '.xml'; allowed: .npz"),
        (("-o", "no/a.csv"), "the folder no does not exist"),
        (("--cycles", 2), "--cycles is of no use for csv"),
        (("--format", "mjcf", "--cycles", 2), "--cycles is of no use for mjcf"),
        (("--format", "npz", "--mjcf", "a.xml"), "--mjcf is of no use for npz"),
        (("other.npz",), "2 files for csv; allowed: one FILE"),
        (("other.npz", "--format", "isaaclab-amp"), "2 motions for isaaclab-amp; allowed: one"),
        (("--format", "isaaclab-amp", "-o", "a.csv"), "a.csv does not end with .npz"),
        (("--format", "isaaclab-amp", "-o", "hop.npz"), "hop.npz is an input file"),
        (("--format", "isaaclab-amp", "-o", "other.npz"), "other.npz is a solution file; allowed: another"),
        (("--format", "isaaclab-amp", "-o", "no/a.npz"), "the folder no does not exist"),
        (("--format", "isaaclab-amp", "--quaternion", "wxyz"), "--quaternion is of no use for isaaclab-amp"),
        (("--format", "isaaclab-amp", "--mjcf", "a.xml"), "mjcf is of no use for isaaclab-amp"),
        (("--format", "isaaclab-amp", "--cycles", 2), "the solution is not periodic; allowed: --cycles 1"),
        (("--format", "isaaclab-amp", "--cycles", 0), "cycles"),
        (("--format", "isaaclab-amp", "--rate", 0), "rate"),
        (("--format", "mjlab", "--mjcf", "none.xml"), "cannot read none.xml"),
        (("--format", "rosbag", "--task", "hop"), "task is of no use for rosbag; allowed: fields"),
        (("--format", "npz", "--task", "hop"), "--task is of no use for npz"),
        (("--format", "lerobot", "--rate", 12.5), "rate is 12.5 Hz; allowed for lerobot: a whole number"),
        (("--format", "lerobot", "-o", "hop.npz"), "hop.npz is an input file"),
        (("--format", "lerobot", "-o", "other.npz"), "other.npz: it is not a folder"),
        (("--format", "mujoco", "-o", "."), "cannot write .: it is there and is no such export"),
        (("other.npz", "--format", "rosbag"), "2 motions for rosbag; allowed: one"),
        (("--format", "amp-hardware"), "allowed: a quadruped with a floating base"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(
    plan: Path, words: tuple[object, ...], message: str
) -> None:
    solution_of_kind("points").save("other.npz")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    assert_refused(export("hop.npz", *words), message)
    assert before == {path: path.read_bytes() for path in Path().iterdir()}


def test_a_file_that_is_no_solution_is_refused(plan: Path) -> None:
    Path("a.npz").write_text("hello")
    for name in ("a.npz", "none.npz"):
        assert_refused(export(name), name)


def test_a_solution_that_is_no_success_is_written_with_a_warning(plan: Path) -> None:
    solution = Solution.load(plan)
    with_meta(solution, success=False, status="coarse_grid").save("bad.npz")
    result = export("bad.npz", "--format", "npz")
    assert result.exit_code == 0
    assert "warning: bad.npz is not a success: coarse_grid" in result.stderr
    with np.load("bad-500hz.npz") as archive:
        assert str(archive["success"]) == "False"
