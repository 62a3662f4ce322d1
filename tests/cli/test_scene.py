"""Commands beside solve: list, diagnose, plot, and the smallest model of a problem."""

import json
from pathlib import Path

import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.problems import one_joint_arm
from tests.support.synthetic_motions import arm_motion, sampled, with_meta
from trajopt.motion.solution import Solution
from trajopt.problem.catalogue import families

# Of 12 intervals 4, 3 and 5 in stance, flight and landing; a whole node has 37 entries, a half 18, a point 18
# or 9 accelerations and on four or two feet 12 or 6 forces.
WHOLE = 13 * 37 + 9 * 2 * (18 + 12) + 3 * 2 * 18
HALF = 13 * 18 + 9 * 2 * (9 + 6) + 3 * 2 * 9
JUMP = ("solve", "solo12-jump", "--set", "distance=10cm", "--intervals", "12")


@pytest.fixture(scope="module")
def explained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    file = tmp_path_factory.mktemp("scene") / "jump.npz"
    return invoke(*JUMP, "--smallest", "--explain", "--output", file), file


@pytest.mark.long
def test_explain_says_what_is_modelled_what_is_not_and_why_before_it_solves(
    explained: tuple[Result, Path],
) -> None:
    result, _ = explained
    assert result.exit_code == 1, result.output  # its feet drift on so coarse a mesh
    text = result.stdout
    order = [
        "modelled",
        "left out, exactly",
        "left out, a choice",
        "kept:",
        "size ",
        "solved at",
        "objective",
    ]
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert f"{WHOLE} -> {HALF} variables" in text
    assert "beyond 30 m g l" in text


@pytest.mark.long
def test_the_file_of_a_scene_is_the_whole_robots(explained: tuple[Result, Path]) -> None:
    solution = Solution.load(explained[1])
    assert solution.model.nv == 18
    assert solution.f.shape[1] == 4
    assert solution.statistics.variables == HALF


@pytest.mark.long
def test_smallest_solves_the_same_silently_and_json_has_the_scene(tmp_path: Path) -> None:
    result = invoke(*JUMP, "--smallest", "--json", "--output", tmp_path / "jump.npz")
    report = json.loads(result.stdout)
    assert report["variables"] == report["scene"]["after"]["variables"] == HALF
    assert report["scene"]["before"]["variables"] == WHOLE
    assert report["scene"]["exact"] is False
    kinds = {decision["kind"] for decision in report["scene"]["decisions"]}
    assert kinds <= {"exact", "choice", "kept", "offer"}


@pytest.mark.long
@pytest.mark.slow
def test_a_lifted_motion_that_misses_the_check_is_solved_for_the_whole_robot(tmp_path: Path) -> None:
    file = tmp_path / "jump.npz"
    result = invoke("solve", "solo12-jump", "--smallest", "--output", file)
    assert result.exit_code == 0, result.output
    assert "whole robot: solved from the reduced motion" in result.stdout
    assert invoke("check", file).exit_code == 0


@pytest.mark.long
def test_without_these_options_the_problem_is_solved_as_it_is_built(tmp_path: Path) -> None:
    report = json.loads(invoke(*JUMP, "--json", "--output", tmp_path / "jump.npz").stdout)
    assert report["variables"] == WHOLE
    assert "scene" not in report


@pytest.mark.long
def test_an_explanation_alone_changes_nothing(tmp_path: Path) -> None:
    report = json.loads(invoke(*JUMP, "--explain", "--json", "--output", tmp_path / "jump.npz").stdout)
    assert report["variables"] == WHOLE
    assert report["scene"]["after"]["variables"] == HALF
    assert Solution.load(tmp_path / "jump.npz").statistics.variables == WHOLE


@pytest.mark.long
def test_a_joint_to_keep_must_exist(tmp_path: Path) -> None:
    result = invoke(*JUMP, "--keep", "FL_HIP", "--output", tmp_path / "jump.npz")
    assert_refused(result, "joint 'FL_HIP' to keep is unknown; one of root_joint, FL_HAA")


GRID = ("--intervals", "6")
COARSE = ("solve", "ur5-reach", "--intervals", "2")


def said(*words: object, status: int = 0) -> str:
    """What a command prints that ends with that status."""
    result = invoke(*words)
    assert result.exit_code == status, result.output
    return result.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnose")


def test_a_failed_solve_points_to_its_diagnosis_and_its_file_is_diagnosed(folder):
    file = folder / "short.npz"
    short = ("solve", "ur5-reach", "--set", "duration=0.1", "--max-iterations", "40", *GRID)
    assert said(*short, "--output", file, status=1).splitlines()[-1].endswith(f" trajopt diagnose {file}")
    text = said("diagnose", file)
    assert "goal out of reach" in text or "early" in text
    assert "conflict" in text
    diagnosis = json.loads(said("diagnose", file, "--json"))
    assert (diagnosis["problem"], diagnosis["clean"]) == ("ur5-reach", False)
    assert diagnosis["advice"]
    assert diagnosis["conflict"]["giving"][0]["amount"] > 0


def test_diagnose_of_a_solve_is_printed_and_leaves_the_exit_status_alone(folder):
    grid = (*GRID, "--transcription", "legendre:4")
    words = ("solve", "ur5-reach", *grid, "--output", folder / "reach.npz", "--diagnose")
    text = said(*words)
    assert "the second-order condition holds" in text
    assert "trajopt diagnose" not in text
    assert json.loads(said(*words, "--json"))["diagnosis"]["feasible"] is True


def test_the_problem_of_a_file_may_be_named(folder):
    file = folder / "reach.npz"
    invoke("solve", "ur5-reach", *GRID, "--output", file)
    assert "they differ" in said("diagnose", file, "--problem", "ur5-reach", "--set", "duration=2")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere.npz",), "nowhere.npz does not exist"),
        (("FILE", "--problem", "ur5-rech"), "did you mean ur5-reach"),
        (("FILE", "--set", "x=1"), "allowed: with --problem NAME"),
        (("FILE", "--problem", "double-pendulum"), "problem 'double-pendulum' is on robot 'double_pendulum'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(folder, words, message):
    file = folder / "small.npz"
    if not file.exists():
        invoke(*COARSE, "--output", file)
    assert_refused(invoke("diagnose", *(file if word == "FILE" else word for word in words)), message)


def test_a_file_of_a_problem_that_nobody_knows_is_refused(folder):
    file = folder / "known.npz"
    invoke(*COARSE, "--output", file)
    foreign = with_meta(Solution.load(file), problem="my-own").save(folder / "foreign.npz")
    assert_refused(invoke("diagnose", foreign), "problem 'my-own' is not in the catalogue")


def _listed(*arguments: str) -> list[str]:
    result = invoke("list", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return [entry["name"] for entry in json.loads(result.output)["problems"]]


def test_patterns_choose_problems() -> None:
    assert _listed("arm-re*", "hopper-hop") == ["arm-reach", "hopper-hop"]


def test_a_robot_chooses_the_problems_it_is_tested_on() -> None:
    names = _listed("--robot", "go2")
    assert "quadruped-trot" in names
    assert all(name.startswith("quadruped-") for name in names)


def test_without_a_problem_each_has_a_line_under_the_robots_of_its_kind() -> None:
    result = invoke("list")
    assert {line.split(":")[0] for line in result.output.splitlines() if line[:1].isupper()} == {
        "Arms", "Quadrupeds", "Bipeds", "Others",
    }  # fmt: skip
    assert max(map(len, result.output.splitlines())) <= 80
    assert "torque_limit" not in result.output
    for name in families():
        assert sum(line.startswith(f"  {name} ") for line in result.output.splitlines()) == 1, name


def test_a_named_problem_is_shown_in_full_unless_brief_is_asked_for() -> None:
    assert "parameter  " in invoke("list", "arm-reach").output
    brief = invoke("list", "arm-reach", "--brief").output
    assert "panda" in brief
    assert "parameter  " not in brief
    assert_refused(invoke("list", "--brief", "--full"), "--brief and --full are both given")


@pytest.mark.parametrize(
    ("arguments", "says"), [(["no-such*"], "'no-such*' is unknown"), (["--robot", "nao"], "'nao' is unknown")]
)
def test_unknown_names_are_refused_with_what_is_known(arguments: list[str], says: str) -> None:
    assert_refused(invoke("list", *arguments), says)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    robot = one_joint_arm()
    return sampled(robot, [arm_motion(robot)], 2).save(tmp_path / "arm.npz")


def plot(*arguments: object) -> Result:
    return invoke("plot", *arguments)


@pytest.mark.long
def test_a_page_is_written_and_named_with_its_size(file: Path, tmp_path: Path) -> None:
    target = tmp_path / "arm.svg"
    result = plot(file, "-o", target, "--pages", "joints,momentum")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"{target}: joints, momentum, ")
    assert f"{target.stat().st_size / 1e6:.2f} MB" in result.stdout


@pytest.mark.long
def test_labels_name_the_solutions_of_several_files(file: Path, tmp_path: Path) -> None:
    result = plot(
        file, file, "-o", tmp_path / "two.html", "--page", "joints", "--label", "A", "--label", "B & C"
    )
    assert result.exit_code == 0, result.output
    text = (tmp_path / "two.html").read_text()
    assert '<th class="number">A</th>' in text
    assert "B &amp; C" in text


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("FILE", "-o", "FOLDER/a.gif"), "allowed: .png, .svg, .pdf, .html"),
        (("FILE", "-o", "FOLDER/missing/a.png"), "does not exist"),
        (("FILE", "-o", "FOLDER"), "its ending is ''"),
        (("FOLDER/none.npz", "-o", "FOLDER/a.png"), "none.npz does not exist"),
        (("FILE", "-o", "FOLDER/a.png", "--page", "force"), "page 'force' is unknown"),
        (("FILE", "-o", "FOLDER/a.png", "--page", "soles"), "nothing for page soles"),
        (("FILE", "-o", "FOLDER/a.png", "--label", "a", "--label", "b"), "2 labels for 1 solutions"),
        (("FILE",), "'-o'"),
        (("-o", "FOLDER/a.png"), "FILE"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    file: Path, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    places = [word.replace("FILE", str(file)).replace("FOLDER", str(tmp_path)) for word in arguments]
    assert_refused(plot(*places), words)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


@pytest.mark.long
def test_the_file_that_is_read_is_not_replaced(tmp_path: Path, file: Path) -> None:
    same = tmp_path / "arm.png"
    same.write_bytes(file.read_bytes())
    assert_refused(plot(same, "-o", same), "is an input file")
    assert same.read_bytes() == file.read_bytes()


@pytest.mark.long
@pytest.mark.parametrize("label", ["$x^{$", "50 % of \\frac", "word " * 60, "_hidden", "<b>&amp;"])
def test_labels_are_drawn_as_they_are(file: Path, tmp_path: Path, label: str) -> None:
    """A dollar is no mathematics, and a long name is cut."""
    pages = ("-o", tmp_path / "two.png", "--page", "joints")
    result = plot(file, file, *pages, "--label", label, "--label", "other")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""


@pytest.mark.long
def test_names_of_a_file_are_drawn_as_they_are(tmp_path: Path) -> None:
    robot = one_joint_arm()
    plan = sampled(robot, [arm_motion(robot), arm_motion(robot)], 2)
    odd = "$\\frac{ <script>" + 200 * "name "
    names = {"problem": odd, "robot": odd, "phase_names": [odd] * len(plan.phases)}
    with_meta(plan, **names).save(tmp_path / "odd.npz")
    for ending in ("png", "html"):
        result = plot(tmp_path / "odd.npz", "-o", tmp_path / f"odd.{ending}")
        assert result.exit_code == 0, result.output
    assert "<script>" not in (tmp_path / "odd.html").read_text()


@pytest.mark.long
def test_a_report_has_the_same_bytes_whenever_it_is_written(file: Path, tmp_path: Path) -> None:
    for ending in ("pdf", "svg", "png", "html"):
        first, second = tmp_path / f"first.{ending}", tmp_path / f"second.{ending}"
        for target in (first, second):
            assert plot(file, "-o", target, "--page", "joints").exit_code == 0
        assert first.read_bytes() == second.read_bytes()
