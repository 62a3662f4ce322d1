"""Names of files tell the settings; files of the user are kept; what ``trajopt export`` writes, refuses."""

from pathlib import Path

import click
import numpy as np
import pandas as pd
import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.sampled_problems import solution_of_kind
from tests.support.synthetic_motions import with_meta
from trajopt import Solution
from trajopt.cli.commands import main
from trajopt.cli.input import file_of_settings
from trajopt.export.formats import FORMATS

NOTES = "mine, and no output of trajopt\n"


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    file = tmp_path / "notes.txt"
    file.write_text(NOTES, encoding="utf-8")
    return file


def test_a_log_does_not_replace_another_file(notes: Path) -> None:
    done = invoke("solve", "ur5-reach", "--log", notes, "--output", notes.parent / "reach.npz")
    assert_refused(done, "it is there and is no table of iterations", "allowed: another name")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_a_log_of_a_continuation_does_not_replace_its_start(notes: Path) -> None:
    vary = ("--vary", "x=0.2:0.4:2", "--start", notes, "--log", notes)
    assert_refused(invoke("continue", "ur5-reach", *vary), "notes.txt is an input file")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_a_continuation_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    arguments = ("--vary", "x=0.2:0.4:2", "--max-time", 0, "--output-dir", tmp_path / "new" / "out")
    assert_refused(invoke("continue", "ur5-reach", *arguments), "max_time is 0 s")
    assert not (tmp_path / "new").exists()


def test_a_page_of_a_robot_is_a_page(notes: Path) -> None:
    assert_refused(invoke("robot", "ur5", "--html", notes), "does not end with .html")
    assert notes.read_text(encoding="utf-8") == NOTES


def test_results_replace_nothing_else(notes: Path) -> None:
    results = notes.rename(notes.parent / "results.jsonl")
    done = invoke("bench", "suite", "--problems", "ur5-reach", "--output-dir", results.parent)
    assert_refused(done, "it is there and holds no results", "allowed: another folder")
    assert results.read_text(encoding="utf-8") == NOTES


def test_a_sweep_deletes_no_solutions_that_are_not_its_own(tmp_path: Path) -> None:
    mine = tmp_path / "solutions" / "mine.npz"
    mine.parent.mkdir()
    mine.write_text(NOTES, encoding="utf-8")
    done = invoke("bench", "sweep", "ur5-reach", "--output-dir", tmp_path)
    assert_refused(done, "mine.npz is there, without a sweep", "allowed: another folder")
    assert mine.read_text(encoding="utf-8") == NOTES


@pytest.mark.parametrize(
    "words",
    [
        ("check", "~nobody-of-that-name/a.npz"),
        ("solve", "ur5-reach", "--output", "~nobody-of-that-name/a.npz"),
        ("solve", "ur5-reach", "--log", "~nobody-of-that-name/a.csv"),
        ("robot", "~nobody-of-that-name/a.urdf"),
    ],
)
def test_a_home_folder_that_does_not_exist_is_one_line(words: tuple[str, ...]) -> None:
    assert_refused(invoke(*words), "there is no home folder of that user")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("solve", "ur5-reach", "--start", "."), "."),
        (("solve", "ur5-reach", "--ladder", "legendre:1@99999999999999999999"), "--ladder"),
        (("simulate", "a.npz", "--seed", "3"), "--seed has no effect here; allowed: with --noise"),
        (("simulate", "a.npz", "--controller", "whole-body", "--kp", "2"), "--kp has no effect here"),
        (("bench",), "Missing command"),
    ],
)
def test_what_has_no_effect_or_no_end_is_one_line(words: tuple[str, ...], message: str) -> None:
    assert_refused(invoke(*words), message)


# The words of a name, beside the problem's, of the options that are given.
WORDS = {
    "nothing": ((), ()),
    "a parameter": (("--set", "distance=0.8"), ("distance=0.8",)),
    "parameters": (("--set", "yaw = 45deg", "--set", "height=0.1"), ("yaw=45deg", "height=0.1")),
    "a file": (("--set", "robot=my/dog.py"), ("robot=my_dog.py",)),
    "a mesh": (
        ("--transcription", "legendre:4", "--intervals", "12"),
        ("transcription=legendre_4", "intervals=12"),
    ),
    "a model": (("--smallest", "--explain"), ("smallest",)),
    "joints": (("--keep", "FL_HAA", "--keep", "FR_HAA"), ("keep=FL_HAA", "keep=FR_HAA")),
    "a start": (("--start", "files/old.npz", "--compare"), ("start=files_old",)),
    "a target": (("--accuracy", "1e-3"), ("accuracy=0.001",)),
    "a solver": (
        ("--hessian", "gauss-newton", "--solver-option", "mu_init=1e-7"),
        ("hessian=gauss-newton", "mu_init=1e-7"),
    ),
    "limits": (("--max-iterations", "3"), ("max-iterations=3",)),
    "defaults": (("--solver", "ipopt", "--tolerance", "1e-6"), ()),
    "no change of the motion": (("--watch", "--json", "--explain", "--threads", "2", "--diagnose"), ()),
}


@pytest.mark.parametrize("case", WORDS)
def test_a_name_tells_the_settings_that_change_the_motion(case: str) -> None:
    given, words = WORDS[case]
    command = main.get_command(click.Context(main), "solve")
    assert command is not None
    context = command.make_context("solve", ["jump", *given])
    assert sorted(file_of_settings(context).name.removesuffix(".npz").split("-")) == sorted(
        "-".join(("jump", *words)).split("-")
    )


@pytest.mark.long
def test_other_settings_do_not_overwrite_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    hop = ("solve", "hopper-hop", "--intervals", "9")
    for more in ((), ("--set", "distance=0.1")):
        assert invoke(*hop, *more).exit_code == 1  # the mesh is coarse
    first, second = (Path(f"hopper-hop{part}-intervals=9.npz") for part in ("", "-distance=0.1"))
    assert Solution.load(first).description.parameters["distance"] == 0.2
    assert Solution.load(second).description.parameters["distance"] == 0.1


def test_a_name_that_would_be_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    more = [word for joint in range(40) for word in ("--keep", f"joint_{joint}")]
    assert_refused(invoke("solve", "solo12-jump", *more), "a file name of", "allowed: --output FILE")
    assert not list(tmp_path.iterdir())


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
