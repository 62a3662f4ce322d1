"""The package beside a user's own files of the same names: here, and as a wheel in a new environment."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.support.repository import ROOT

# Seconds after which a build, an installation or a solve is ended.
LIMIT = 600
SCRIPT = """
import problems
import robots
import scripts
import trajopt

assert problems.MINE and robots.MINE and scripts.MINE
solution = trajopt.solve(trajopt.load("solo12-jump", distance=0.3))
assert solution.success
assert trajopt.check(solution).ok
print(trajopt.robot("go2").name)
"""


def run(folder: Path, *command: str | Path) -> str:
    """Output of a command that must succeed, run in ``folder`` without this process' own paths."""
    own = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(word) for word in command], cwd=folder, env=own, capture_output=True, text=True, timeout=LIMIT
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's folder with modules named as the folders of this repository."""
    for package in ("robots", "scripts"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("MINE = True\n")
    (tmp_path / "problems.py").write_text("MINE = True\n")
    (tmp_path / "mine.py").write_text(SCRIPT)
    return tmp_path


def solves_both_ways(folder: Path, scripts: Path) -> None:
    """Solve from a script and from the command line, with the programs in ``scripts``."""
    assert run(folder, scripts / "python", "mine.py") == "go2\n"
    run(folder, scripts / "trajopt", "solve", "solo12-jump", "-o", "jump.npz")
    assert (folder / "jump.npz").is_file()


@pytest.mark.long
def test_own_files_named_as_folders_of_the_repository_disturb_nothing(folder: Path) -> None:
    solves_both_ways(folder, Path(sys.executable).parent)


@pytest.mark.slow
def test_wheel_in_a_new_environment_solves_and_installs_nothing_that_collides(
    folder: Path, tmp_path: Path
) -> None:
    uv = os.environ.get("UV") or shutil.which("uv")  # `uv run` names itself
    assert uv is not None, "uv is needed, as for every command of the README"
    run(ROOT, uv, "build", "--wheel", "--out-dir", tmp_path / "dist", ROOT)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        installed = {name.split("/")[0] for name in archive.namelist()}
    assert {name for name in installed if not name.endswith(".dist-info")} == {"trajopt", "trajopt_library"}
    run(folder, uv, "venv", "--python", sys.executable, tmp_path / "new")
    run(folder, uv, "pip", "install", "--python", tmp_path / "new", wheel)
    solves_both_ways(folder, tmp_path / "new" / "bin")
