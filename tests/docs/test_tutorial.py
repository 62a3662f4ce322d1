"""The tutorial, followed literally: every block of it is run in order, and prints what it shows."""

import math
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from tests.support.processes import LIMIT
from tests.support.repository import ROOT

TUTORIAL = ROOT / "docs" / "tutorial" / "bring-your-own-robot.md"
BLOCK = re.compile(r"^```(\w+) ?([\w.]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
# Counts and times that differ from one machine to another.
FREE_UNITS = ("s", "ms", "iterations", "MB")
# Of what is optimised three digits are shared by all machines; below this it is rounding.
RELATIVE, ROUNDING = 0.02, 1e-5


@dataclass(frozen=True)
class Block:
    """A block of the tutorial: its language, the file that its text is saved as, and the text."""

    language: str
    file: str
    text: str


def blocks() -> list[Block]:
    return [Block(*found) for found in BLOCK.findall(TUTORIAL.read_text(encoding="utf-8"))]


def same(shown: str, printed: str) -> bool:
    """Whether a printed line is the shown one but for digits; ``...`` at its end stands for anything."""
    if shown.strip().endswith("..."):
        words = shown.split()[:-1]
        return same(" ".join(words), " ".join(printed.split()[: len(words)]))
    ours, theirs = shown.split(), printed.split()
    if len(ours) != len(theirs):
        return False
    following = [*ours[1:], ""]
    return all(_same_word(*words) for words in zip(ours, theirs, following, strict=True))


def _same_word(shown: str, printed: str, following: str) -> bool:
    if shown == printed:
        return True
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    if following.strip(":;,") in FREE_UNITS:
        return True
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=RELATIVE, abs_tol=ROUNDING) for a, b in pairs)


def missing(shown: str, printed: str) -> list[str]:
    """Lines that are shown and not printed, in their order; a line ``...`` stands for any number of them."""
    left, lost = printed.splitlines(), []
    for line in shown.splitlines():
        if line.strip() == "...":
            continue
        place = next((index for index, entry in enumerate(left) if same(line, entry)), None)
        if place is None:
            lost.append(line)
        else:
            left = left[place + 1 :]
    return lost


def run(script: str, folder: Path) -> str:
    """What a shell block prints; as in the tutorial, the environment is active and the clone is known."""
    tools = str(Path(sys.executable).parent)
    environment = os.environ | {"TRAJOPT": str(ROOT), "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    command = ["bash", "-euo", "pipefail", "-c", script]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(command, cwd=folder, env=environment, text=True, timeout=LIMIT, **both)
    assert done.returncode == 0, f"{script}\n{done.stdout}"
    return done.stdout


def test_a_line_is_compared_but_for_digits_that_differ_between_machines() -> None:
    assert same("solved; ipopt, 16 iterations", "solved;  ipopt, 17 iterations")
    assert same("objective  0.3595", "objective 0.359507")
    assert not same("objective  0.3595", "objective 0.4")
    assert same("jump.html: 1.14 s, 0.4 MB", "jump.html: 1.14 s, 1.2 MB")
    assert not same("tracked", "not tracked")
    assert same("  worst      ...", "  worst      defect in phase 'flight'")
    assert missing("a\n...\nc", "a\nb\nc") == []
    assert missing("c\na", "a\nb\nc") == ["a"]


def test_output_follows_what_prints_it() -> None:
    kinds = [block.language for block in blocks()]
    assert set(kinds) == {"sh", "text", "python"}
    assert all(before == "sh" for before, kind in pairwise(kinds) if kind == "text")
    assert all(block.file.endswith(".py") for block in blocks() if block.language == "python")


@pytest.mark.slow
def test_tutorial_followed_literally(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    printed = ""
    for block in blocks():
        if block.language == "python":
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "sh":
            printed = run(block.text, tmp_path)
        else:
            assert missing(block.text, printed) == [], printed
    pages = {path.name for path in tmp_path.glob("*.html")}
    assert pages == {"puppy.html", "both.html", "jump.html", "paw.html"}
    for page in pages:
        text = (tmp_path / page).read_text(encoding="utf-8")
        assert "http-equiv" in text
        assert "puppy" in text
