"""``trajopt plot``: files, pages, labels, and bad input in one line."""

from pathlib import Path

import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.problems import one_joint_arm
from tests.support.synthetic_motions import arm_motion, sampled, with_meta

pytestmark = pytest.mark.long


@pytest.fixture
def file(tmp_path: Path) -> Path:
    robot = one_joint_arm()
    return sampled(robot, [arm_motion(robot)], 2).save(tmp_path / "arm.npz")


def plot(*arguments: object) -> Result:
    return invoke("plot", *arguments)


def test_a_page_is_written_and_named_with_its_size(file: Path, tmp_path: Path) -> None:
    target = tmp_path / "arm.svg"
    result = plot(file, "-o", target, "--pages", "joints,momentum")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"{target}: joints, momentum, ")
    assert f"{target.stat().st_size / 1e6:.2f} MB" in result.stdout


def test_labels_name_the_solutions_of_several_files(file: Path, tmp_path: Path) -> None:
    result = plot(
        file, file, "-o", tmp_path / "two.html", "--page", "joints", "--label", "A", "--label", "B & C"
    )
    assert result.exit_code == 0, result.output
    text = (tmp_path / "two.html").read_text()
    assert '<th class="number">A</th>' in text
    assert "B &amp; C" in text


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


def test_the_file_that_is_read_is_not_replaced(tmp_path: Path, file: Path) -> None:
    same = tmp_path / "arm.png"
    same.write_bytes(file.read_bytes())
    assert_refused(plot(same, "-o", same), "is an input file")
    assert same.read_bytes() == file.read_bytes()


@pytest.mark.parametrize("label", ["$x^{$", "50 % of \\frac", "word " * 60, "_hidden", "<b>&amp;"])
def test_labels_are_drawn_as_they_are(file: Path, tmp_path: Path, label: str) -> None:
    """A dollar is no mathematics, and a long name is cut."""
    pages = ("-o", tmp_path / "two.png", "--page", "joints")
    result = plot(file, file, *pages, "--label", label, "--label", "other")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""


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


def test_a_report_has_the_same_bytes_whenever_it_is_written(file: Path, tmp_path: Path) -> None:
    for ending in ("pdf", "svg", "png", "html"):
        first, second = tmp_path / f"first.{ending}", tmp_path / f"second.{ending}"
        for target in (first, second):
            assert plot(file, "-o", target, "--page", "joints").exit_code == 0
        assert first.read_bytes() == second.read_bytes()
