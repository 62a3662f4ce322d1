"""Without ``--output`` a file is named for its problem and settings: other settings do not overwrite it."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from tests.support.command_lines import assert_refused, invoke
from trajopt import Solution
from trajopt.cli.commands import main
from trajopt.cli.input import file_of_settings

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
        ("--solver", "fatrop", "--solver-option", "mu_init=1e-7"),
        ("solver=fatrop", "mu_init=1e-7"),
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
