"""``trajopt plot``: files, pages, labels, and bad input in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from problems_for_tests import one_joint_arm
from synthetic import arm_motion, sampled

from trajopt.cli import main


@pytest.fixture
def file(tmp_path: Path) -> Path:
    robot = one_joint_arm()
    return sampled(robot, [arm_motion(robot)], 2).save(tmp_path / "arm.npz")


def plot(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["plot", *map(str, arguments)])


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
    result = plot(*places)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("trajopt: ")
    assert result.stderr.count("\n") == 1
    assert words in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
