"""The package beside a user's own files of the same names: here, and as a wheel in a new environment."""

from __future__ import annotations

import json
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
    run(folder, scripts / "trajopt", "solve", "ur5-reach", "-o", "reach.npz")
    assert json.loads(run(folder, scripts / "trajopt", "check", "reach.npz", "--json"))["ok"]


@pytest.mark.long
def test_own_files_named_as_folders_of_the_repository_disturb_nothing(folder: Path) -> None:
    solves_both_ways(folder, Path(sys.executable).parent)


@pytest.fixture(scope="module")
def uv() -> str:
    found = os.environ.get("UV") or shutil.which("uv")  # `uv run` names itself
    assert found is not None, "uv is needed, as for every command of the README"
    return found


@pytest.fixture(scope="module")
def wheel(uv: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("dist")
    run(ROOT, uv, "build", "--wheel", "--out-dir", target, ROOT)
    (built,) = target.glob("*.whl")
    return built


def installed(uv: str, folder: Path, wheel: Path, *options: str | Path) -> Path:
    """The programs of a new environment in ``folder`` with this wheel."""
    run(folder, uv, "venv", "--python", sys.executable, folder / "new")
    run(folder, uv, "pip", "install", "--python", folder / "new", *options, wheel)
    return folder / "new" / "bin"


@pytest.mark.slow
def test_wheel_installs_nothing_that_collides_and_says_what_it_is_for(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    folders = {name.split("/")[0] for name in names}
    assert {name for name in folders if not name.endswith(".dist-info")} == {"trajopt", "trajopt_library"}
    assert "trajopt/py.typed" in names
    lines = metadata.splitlines()
    assert "Name: trajopt-contacts" in lines
    assert "Classifier: Operating System :: POSIX :: Linux" in lines
    assert any(line.startswith("Requires-Python: ") for line in lines)
    # Wheels of the extensions are for one Python and one platform.
    assert wheel.stem.split("-")[2] == f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert wheel.stem.split("-")[4] != "any"


@pytest.mark.slow
def test_wheel_in_a_new_environment_solves_with_the_locked_versions(
    folder: Path, uv: str, wheel: Path
) -> None:
    locked = folder / "locked.txt"
    run(ROOT, uv, "export", "--locked", "--no-default-groups", "--no-emit-project", "--output-file", locked)
    solves_both_ways(folder, installed(uv, folder, wheel, "--requirements", locked))


@pytest.mark.slow
def test_wheel_solves_with_the_lowest_versions_that_it_allows(folder: Path, uv: str, wheel: Path) -> None:
    solves_both_ways(folder, installed(uv, folder, wheel, "--resolution", "lowest-direct"))
