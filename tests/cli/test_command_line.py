"""The command line: starts, exit status, one JSON object, one line for bad input, files."""

import contextlib
import json
import math
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.processes import TRAJOPT, python, run
from trajopt import Solution
from trajopt.cli.report import console, plain_table, say, to_json
from trajopt.problem import catalogue

# A small hop on a coarse grid: solved within a second, its foot drift is beyond a check's tolerance.
HOP = ("solve", "solo12-jump", "--set", "distance=10cm", "--intervals", "12")
# What is built and stopped at once.
SMALL = ("solve", "hopper-hop", "--intervals", "4", "--max-iterations", "1")
# No leg can push so far in so short a time.
IMPOSSIBLE = ("--set", "distance=1", "--set", "flight=0.05", "--set", "stance=0.05")
KEYS = {
    "problem", "robot", "success", "status", "advice", "iterations", "objective", "variables", "constraints",
    "max_violation", "worst_blocks", "wall_time_s", "function_time_s", "build_time_s", "compile_time_s",
    "accuracy", "file", "solver", "transcription", "intervals", "tolerance", "seed", "perturb",
    "parameters", "warm_start",
}  # fmt: skip


def trajopt_process(*arguments: object, folder: Path) -> subprocess.CompletedProcess[str]:
    return run(*TRAJOPT, *arguments, cwd=folder)


def strict(text: str) -> dict:  # type: ignore[type-arg]
    """The one JSON object that ``text`` is; NaN and Infinity are no JSON."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} in JSON")

    read = json.loads(text, parse_constant=refuse)
    assert isinstance(read, dict)
    return read


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cli")


@pytest.fixture(scope="module")
def hop(folder: Path) -> Result:
    """The hop, solved with the default output."""
    with contextlib.chdir(folder):
        return invoke(*HOP, "--json")


@pytest.fixture(scope="module")
def hop_file(hop: Result, folder: Path) -> Path:
    return folder / strict(hop.stdout)["file"]


def test_list_json_names_robot_phases_and_parameters() -> None:
    result = invoke("list", "--json")
    assert result.exit_code == 0
    problems = {problem["name"]: problem for problem in strict(result.stdout)["problems"]}
    jump = problems["solo12-jump"]
    assert jump["robot"] == "solo12"
    assert jump["phases"] == ["stance", "flight", "landing"]
    distance = next(entry for entry in jump["parameters"] if entry["name"] == "distance")
    assert set(distance) == {"name", "default", "unit", "lower", "upper", "meaning"}


def test_list_shows_every_parameter_with_its_unit() -> None:
    result = invoke("list", "--full")
    assert result.exit_code == 0
    for family in catalogue.families().values():
        assert family.name in result.stdout
        for parameter in family.parameters:
            range_ = [] if parameter.upper is None else [f"{parameter.upper:g} {parameter.unit}"]
            shown = getattr(parameter, "choices", range_)
            assert all(text.rstrip() in result.stdout for text in shown)


@pytest.mark.long
def test_json_of_a_solve_is_one_object_with_the_agreed_keys(hop: Result) -> None:
    assert hop.exit_code == 1, hop.stderr  # its feet drift on so coarse a mesh
    assert hop.stderr == ""  # no terminal: progress is silent
    report = strict(hop.stdout)
    assert set(report) >= KEYS
    assert (report["success"], report["status"], report["converged"]) == (False, "coarse_grid", True)
    assert report["max_violation"] <= report["tolerance"]
    assert report["intervals"] == 12
    assert report["parameters"]["distance"] == pytest.approx(0.1)  # given as 10cm


@pytest.mark.long
def test_default_output_is_named_for_the_settings(hop_file: Path) -> None:
    assert hop_file.name == "solo12-jump-distance=10cm-intervals=12.npz"
    assert Solution.load(hop_file).converged


def test_accuracy_is_what_check_prints(hop: Result, hop_file: Path) -> None:
    result = invoke("check", hop_file, "--json")
    checked, accuracy = strict(result.stdout), strict(hop.stdout)["accuracy"]
    assert checked["failures"] == accuracy["failures"]
    assert checked["foot_drift"] == pytest.approx(accuracy["foot_drift"])


def test_check_beyond_tolerance_ends_with_one(hop_file: Path) -> None:
    result = invoke("check", hop_file)
    assert result.exit_code == 1
    assert "beyond" in result.stdout
    assert strict(invoke("check", hop_file, "--json").stdout)["ok"] is False


@pytest.mark.long
def test_summary_says_where_the_file_is_and_what_is_beyond(tmp_path: Path) -> None:
    target = tmp_path / "no suffix"
    result = invoke(*HOP, "--output", target)
    assert result.exit_code == 1, result.stderr
    assert target.is_file()
    assert f"trajopt diagnose '{target}'" in result.stdout
    assert "solved at its points only, coarse grid" in result.stdout
    assert "times what is allowed" in result.stdout
    assert Solution.load(target).converged


def test_solve_leaves_the_handler_of_ctrl_c_as_it_was(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    assert invoke(*SMALL, "--output", tmp_path / "x.npz").exit_code == 1
    assert signal.getsignal(signal.SIGINT) is before
    assert signal.set_wakeup_fd(-1) == -1


@pytest.mark.long
def test_chatter_of_the_solver_is_not_on_stdout(tmp_path: Path) -> None:
    done = trajopt_process(*SMALL, "--solver-option", "print_level=5", "--json", folder=tmp_path)
    assert strict(done.stdout)["solver"] == "ipopt"


@pytest.mark.long
def test_iteration_limit_ends_with_one_and_names_the_worst_rows(tmp_path: Path) -> None:
    target = tmp_path / "x.npz"
    result = invoke(*HOP, "--max-iterations", 2, "--output", target, "--json")
    report = strict(result.stdout)
    assert result.exit_code == 1
    assert (report["success"], report["status"]) == (False, "iteration_limit")
    assert "--max-iterations" in report["advice"]
    assert all(block["phase"] in ("stance", "flight", "landing") for block in report["worst_blocks"])
    assert Solution.load(target).success is False


@pytest.mark.slow
def test_impossible_goal_ends_with_one_and_names_rows_phase_and_time(tmp_path: Path) -> None:
    result = invoke(
        *HOP[:2], *IMPOSSIBLE, "--intervals", 12, "--max-iterations", 80, "--output", tmp_path / "x.npz"
    )
    assert result.exit_code == 1
    assert "NOT solved" in result.stdout
    first = result.stdout.splitlines()[1:4]
    assert [line.split()[0] for line in first if not line.strip().startswith("where")][:2] == ["fails", "try"]
    assert all(len(line) < 250 for line in first)
    worst = [line for line in result.stdout.splitlines() if line.strip().startswith("worst")]
    assert len(worst) == 3
    assert all(" in phase '" in line and "t = " in line for line in worst)


BAD = {
    "no command": ((), ["Missing command"]),
    "unknown command": (("sole",), ["sole", "allowed: batch, bench, check"]),
    "no problem": (("solve",), ["PROBLEM"]),
    "unknown problem": (("solve", "solo12-jmp"), ["did you mean solo12-jump?"]),
    "unknown option": ((*HOP, "--sovler", "ipopt"), ["--sovler"]),
    "two files": (("check", "a", "b"), ["b"]),
    "unknown parameter": ((*HOP, "--set", "distanc=1"), ["did you mean distance?", "yaw"]),
    "parameter is nan": ((*HOP[:2], "--set", "distance=nan"), ["distance is nan", "-1 to 1 m"]),
    "parameter is no number": ((*HOP[:2], "--set", "distance=far"), ["distance='far'", "-1 to 1 m"]),
    "parameter out of range": ((*HOP[:2], "--set", "yaw=90"), ["yaw is 90", "yaw=90deg"]),
    "negative duration": ((*HOP, "--set", "stance=-1"), ["stance is -1", "0.001 to 10 s"]),
    "no duration": ((*HOP, "--set", "stance=0"), ["stance is 0"]),
    "set without value": ((*HOP, "--set", "yaw"), ["--set 'yaw'", "NAME=VALUE"]),
    "set twice": ((*HOP, "--set", "yaw=0", "--set", "yaw=1"), ["'yaw' twice", "0 and 1"]),
    "unknown scheme": ((*HOP, "--transcription", "legendre:9"), ["legendre:9", "legendre:1..4"]),
    "empty scheme": ((*HOP, "--transcription", ""), ["unknown transcription ''"]),
    "too few intervals": ((*HOP[:-2], "--intervals", "2"), ["2 intervals for 3 phases", "at least 3"]),
    "no intervals": ((*HOP[:-2], "--intervals", "0"), ["0 intervals"]),
    "negative intervals": ((*HOP[:-2], "--intervals", "-5"), ["-5 intervals"]),
    "intervals no number": ((*HOP[:-2], "--intervals", "many"), ["'--intervals'", "whole number"]),
    "intervals beyond memory": ((*HOP[:-2], "--intervals", "10000000"), ["'--intervals'", "100000"]),
    "unknown solver": ((*HOP, "--solver", "snopt"), ["snopt", "allowed: ipopt"]),
    "tolerance": ((*HOP, "--tolerance", "nan"), ["tolerance of solve is nan", "allowed: a finite number"]),
    "perturbation": ((*HOP, "--perturb", "-1"), ["perturb is -1"]),
    "seed": ((*HOP, "--seed", "-1"), ["'--seed'", "-1"]),
    "iterations": ((*HOP, "--max-iterations", "1e3"), ["'--max-iterations'", "whole number"]),
    "time": ((*HOP, "--max-time", "0"), ["max_time is 0 s"]),
    "threads": ((*HOP, "--threads", "0"), ["'--threads'"]),
    "misspelt option": ((*HOP, "--tolerence", "1"), ["'--tolerence'", "--tolerance"]),
    "option twice": ((*HOP, "--seed", "1", "--seed=2"), ["--seed is given 2 times; allowed: once"]),
    "option by both names": ((*HOP, "-o", "a.npz", "--output", "b.npz"), ["--output is given 2 times"]),
    "solver's tolerance": ((*HOP, "--solver-option", "tol=1e-3"), ["tol", "allowed: --tolerance"]),
    "solver's limit": ((*HOP, "--solver-option", "max_iter=3"), ["max_iter", "allowed: --max-iterations"]),
    "misspelt command": (("sovle",), ["no command 'sovle'; did you mean solve? allowed: "]),
    "unknown member": (("bench", "sweeep"), ["did you mean sweep? allowed: outside, reference, suite"]),
    "solver option form": ((*HOP, "--solver-option", "tol"), ["--solver-option 'tol'"]),
    "solver option nan": ((*HOP, "--solver-option", "mu_init=nan"), ["mu_init is nan"]),
    "ipopt option": ((*HOP, "--solver-option", "mu_strateg=x"), ["ipopt", "mu_strateg"]),
    "ipopt value": ((*HOP, "--solver-option", "mu_strategy=x"), ["ipopt", "mu_strategy"]),
    "ipopt option not here": ((*HOP, "--solver-option", "linear_solver=ma27"), ["ipopt", "linear_solver"]),
}


@pytest.mark.long
@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_line_and_two(
    arguments: tuple[str, ...], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(invoke(*arguments), *words)
    assert not list(tmp_path.iterdir())


def test_output_is_refused_before_anything_else_of_the_solve(tmp_path: Path) -> None:
    file, locked = tmp_path / "file", tmp_path / "locked.npz"
    file.write_text("mine")
    locked.touch(0o444)
    places = {
        tmp_path / "none" / "x.npz": "does not exist",
        file / "x.npz": "is not a folder",
        Path("/proc/x.npz"): "cannot write /proc/x.npz",
        tmp_path: "it is a folder",
        Path("/dev/null"): "not a regular file",
        tmp_path / ("n" * 250): "too long",
        file: "it is there and is no solution file; allowed: another name",
        locked: "it is write-protected; allowed: a file in an existing folder",
    }
    for place, words in places.items():
        assert_refused(invoke(*HOP, "--solver", "unknown", "--output", place), words)
    assert {path.name for path in tmp_path.iterdir()} == {"file", "locked.npz"}
    assert file.read_text() == "mine"


STEERING = "\x1b[2Jgo\u202e\x07"
ESCAPED = r"\x1b[2Jgo\u202e\x07"


def test_what_could_steer_a_terminal_is_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    assert_refused(invoke("solve", STEERING), f"problem '{ESCAPED}' is unknown")
    say(f"robot {STEERING}\n\tü")
    console().print(plain_table(("name",), [(STEERING,)]))
    console().print(STEERING)
    shown = capsys.readouterr().out
    assert [line.rstrip() for line in shown.splitlines()] == [
        f"robot {ESCAPED}", "\tü", "name", ESCAPED, ESCAPED,
    ]  # fmt: skip


@pytest.mark.long
def test_a_cache_that_cannot_be_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRAJOPT_CACHE_DIR", "/proc/none")
    result = invoke(*SMALL, "--output", tmp_path / "x.npz")
    assert (tmp_path / "x.npz").exists()
    told = [line for line in result.stderr.splitlines() if "/proc/none" in line]
    assert len(told) == 1
    assert "TRAJOPT_CACHE_DIR" in told[0]


@pytest.mark.parametrize("verb", ["check", "replay"])
def test_files_that_are_no_solution_are_refused(verb: str, hop_file: Path, tmp_path: Path) -> None:
    truncated, foreign, text = tmp_path / "truncated.npz", tmp_path / "foreign.npz", tmp_path / "text.npz"
    truncated.write_bytes(hop_file.read_bytes()[:5000])
    np.savez(foreign, x=np.arange(3))
    text.write_text("no archive")
    assert_refused(invoke(verb, truncated), "truncated.npz is truncated or damaged")
    assert_refused(invoke(verb, foreign), "foreign.npz is not a trajopt-solution file")
    assert_refused(invoke(verb, text), "text.npz is not a trajopt-solution file")
    assert_refused(invoke(verb, tmp_path / "missing.npz"), "missing.npz does not exist")
    assert_refused(invoke(verb, tmp_path), "is not a file")


def test_replay_writes_a_page(hop_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "hop.html"
    result = invoke("replay", hop_file, "--html", page)
    assert result.exit_code == 0, result.stderr
    assert str(page) in result.stdout
    assert "<html" in page.read_text()[:1000]
    assert_refused(invoke("replay", hop_file, "--html", tmp_path / "none" / "x.html"), "none/x.html")
    before = hop_file.read_bytes()
    assert_refused(invoke("replay", hop_file, "--html", hop_file), "is an input file")
    assert hop_file.read_bytes() == before
    assert_refused(invoke("replay", hop_file, "--html", "/dev/null"), "not a regular file")
    assert_refused(invoke("replay", hop_file, "--html", page, "--speed", "1e-9"), "a higher speed")


def test_module_and_version_run(tmp_path: Path) -> None:
    done = trajopt_process("--version", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "version" in done.stdout


def test_numbers_that_are_not_finite_are_null_in_json() -> None:
    text = to_json({"a": math.nan, "b": [math.inf, 1.0], "c": {"d": -math.inf}})
    assert strict(text) == {"a": None, "b": [None, 1.0], "c": {"d": None}}


def test_a_log_replaces_neither_the_solution_nor_the_start(hop_file: Path, tmp_path: Path) -> None:
    before = hop_file.read_bytes()
    solve = ("solve", "hopper-hop", "--log", hop_file)
    assert_refused(invoke(*solve, "-o", hop_file), "written twice")
    assert_refused(invoke(*solve, "-o", tmp_path / "new.npz", "--start", hop_file), "is an input file")
    assert hop_file.read_bytes() == before
    assert not (tmp_path / "new.npz").exists()


@pytest.mark.long
def test_solve_without_a_mesh_tells_the_grade_and_passes_the_check(tmp_path: Path) -> None:
    target = tmp_path / "reach.npz"
    result = invoke("solve", "ur5-reach", "--output", target)
    assert result.exit_code == 0, result.output
    assert "grade: holds at any time; the grade is reached" in result.stdout
    assert invoke("check", target).exit_code == 0
    draft = strict(invoke("solve", "ur5-reach", "--draft", "--json", "-o", target).stdout)
    assert len(draft["graded"]["rounds"]) == 1
    fixed = strict(invoke("solve", "ur5-reach", "--fixed-mesh", "--json", "-o", target).stdout)
    assert fixed["intervals"] == 30
    assert_refused(invoke("solve", "ur5-reach", "--draft", "--fixed-mesh"), "--draft and a mesh")


CONTRADICTIONS = {
    "seed": (("solve", *HOP[1:], "--seed", "5"), "--seed has no effect here; allowed: with --perturb SIGMA"),
    "solution": (("solve", *HOP[1:], "-o", "x.txt"), "x.txt does not end with .npz; allowed: NAME.npz"),
    "accuracy": (
        ("solve", *HOP[1:], "--accuracy", "1km"),
        "'1km' is not a length above 0, allowed: such as 1e-3, 1mm",
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradictions_and_silences_are_one_line(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, said = CONTRADICTIONS[case]
    assert_refused(invoke(*arguments), said)
    assert list(tmp_path.iterdir()) == []


def test_options_of_solve_are_grouped():
    shown = invoke("solve", "--help").output
    headings = [line for line in shown.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert headings == [
        "Problem:", "Accuracy and mesh:", "Start:", "Solver:", "Watching:", "Output:", "Other options:",
    ]  # fmt: skip
    assert shown.split("Other options:")[1].split()[:2] == ["-h,", "--help"]
    assert shown.split("Other options:")[1].count(" --") == 1


def test_layers_that_may_be_hidden_are_listed():
    from trajopt.cli.view import LAYERS
    from trajopt.view.replay.scene import LAYERS as KNOWN

    assert LAYERS.replace(" or ", ", ").split(", ") == [layer[0] for layer in KNOWN]


def test_a_file_without_a_table_of_bands_is_refused_before_solving(tmp_path):
    (tmp_path / "bands.csv").write_text("garbage\n", "utf-8")
    arguments = ("bench", "suite", "--problems", "ur5-reach", "--compare", tmp_path / "bands.csv")
    assert_refused(invoke(*arguments), "bands.csv has no table of bands: column problem is missing")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_said_with_the_name_of_the_log(tmp_path):
    target = tmp_path / "arm.npz"
    result = invoke("solve", "ur5-reach", "--draft", "--log", "/dev/full", "-o", target)
    assert result.exit_code == 2
    assert_refused(result, "cannot write /dev/full: No space left on device")


START = {"click", "lazy_loader", "platformdirs", "typing_extensions"}
MODELS = {"numpy", "casadi", "pinocchio", "coal"}
PHYSICS = {"mujoco", "glfw", "piqp"}
DRAWING = {"matplotlib", "mpl_toolkits", "PIL", "cycler", "dateutil", "fontTools", "kiwisolver", "packaging"}
PAGE = {"meshcat", "IPython", "PIL", "colorama", "pygments", "tornado", "traitlets", "umsgpack", "zmq"}
# What a command may load besides `START`, third-party packages alone. OSQP and PIQP need SciPy for sparse
# programs (guesses of walks), diagnosis for factorisations, and each mesh once: its hull is then in
# the cache.
MAY_LOAD = {
    "list": MODELS,
    "list --json": set(),  # from the cache, where the first has left it
    "solve hopper-hop -o hop.npz": MODELS,
    "solve ur5-reach --intervals 4 -o reach.npz": MODELS,
    "check hop.npz": MODELS,
    "simulate hop.npz": MODELS | PHYSICS,
    "drive ur5 --script place.csv --seconds 0.1": MODELS | PHYSICS,
    "replay hop.npz --html hop.html": MODELS | PAGE,
    "plot hop.npz -o hop.svg": MODELS | DRAWING | {"pyparsing"},
}
LOADED = """
packages = {name.partition(".")[0] for name in set(sys.modules) - begin} - set(sys.stdlib_module_names)
print(*(name for name in packages if name[0] != "_" and sys.modules[name].__spec__))
"""
HELP = """
from click.testing import CliRunner
from trajopt.cli.commands import COMMANDS, main
for words in ([], *([name] for name in COMMANDS)):
    result = CliRunner().invoke(main, [*words, "--help"])
    assert result.exit_code == 0, result.output
    assert "Usage:" in result.output
"""
COMMAND = """
from click.testing import CliRunner
from trajopt.cli.commands import main
result = CliRunner().invoke(main, {words})
assert result.exit_code in (0, 1), result.output
"""
MISMATCH = """
import sys, trajopt.versions
import importlib.metadata as metadata
real = metadata.version
trajopt.versions.version = lambda name: "0.0.1" if name == "casadi" else real(name)
from trajopt.cli import main
sys.argv = ["trajopt", *sys.argv[1:]]
sys.exit(main())
"""


@pytest.mark.parametrize(
    "code", ["import trajopt", "import trajopt.cli", HELP], ids=["library", "cli", "help"]
)
def test_nothing_heavy_is_loaded_at_the_start(code: str) -> None:
    assert _loaded_by(code) <= START


@pytest.mark.long
def test_commands_load_the_packages_that_they_need(tmp_path: Path) -> None:
    (tmp_path / "place.csv").write_text("time,x,y,z\n0.0,0.5,0.2,0.5\n")
    for command, packages in MAY_LOAD.items():
        loaded = _loaded_by(COMMAND.format(words=command.split()), cwd=tmp_path)
        assert loaded <= START | packages, command


def _loaded_by(code: str, **options: Any) -> set[str]:
    """Third-party packages that a process of its own has loaded for the code."""
    done = python(f"import sys\nbegin = set(sys.modules)\n{code}\n{LOADED}", **options)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split()) - {"trajopt", "trajopt_library"}


@pytest.mark.long
def test_wheels_that_do_not_match_end_in_one_line():
    done = python(MISMATCH, "solve", "ur5-reach")
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert "casadi 0.0.1" in line
    assert "pip install casadi==" in line


@pytest.mark.long
def test_package_runs_the_command_line():
    done = run(sys.executable, "-m", "trajopt", "solve", "no-such-problem")
    assert done.returncode == 2
    assert "no-such-problem" in done.stderr
