"""Folders are written completely or not at all, and what is no such folder stays."""

from pathlib import Path

import pytest

from tests.support.refusals import assert_refused_in_one_line
from trajopt.solution.output import replacing_folder

MARKER = "meta/info.json"


def write(target: Path, text: str) -> None:
    with replacing_folder(target, MARKER) as unfinished:
        (unfinished / "meta").mkdir()
        (unfinished / MARKER).write_text(text)


def test_a_folder_is_made_and_replaced_by_a_later_one(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    for text in ("first", "second"):
        write(target, text)
        assert (target / MARKER).read_text() == text
        (target / "left over").touch()
        assert [path.name for path in tmp_path.iterdir()] == ["out"]
    write(target, "third")
    assert [path.name for path in target.iterdir()] == ["meta"]


def test_an_error_within_leaves_the_earlier_folder(tmp_path: Path) -> None:
    def fail() -> None:
        with replacing_folder(tmp_path / "out", MARKER) as unfinished:
            (unfinished / "half").touch()
            raise KeyError

    write(tmp_path / "out", "first")
    with pytest.raises(KeyError):
        fail()
    assert (tmp_path / "out" / MARKER).read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_other_folders_and_files_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "diary.txt").write_text("dear")
    (tmp_path / "file").write_text("text")
    for name, words in (
        ("other", "it is there and is no such export; allowed: another name"),
        ("file", "it is not a folder"),
        ("no/out", "does not exist"),
    ):
        assert_refused_in_one_line(lambda name=name: write(tmp_path / name, "new"), words)
    assert (tmp_path / "other" / "diary.txt").read_text() == "dear"
    assert (tmp_path / "file").read_text() == "text"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "other"]
