"""The package beside a user's own files of the same names: here, and as a wheel in a new environment."""

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


def run(folder: Path, *command: str | Path, path: Path | None = None) -> str:
    """Output of a command that must succeed, run in ``folder`` without this process' own paths.

    path: the only folder of programs that the command finds.
    """
    own = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    own |= {} if path is None else {"PATH": str(path)}
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
    """Solve from a script and from the command line, check and draw, without a compiler on the path."""
    assert run(folder, scripts / "python", "mine.py", path=scripts) == "go2\n"
    run(folder, scripts / "trajopt", "solve", "ur5-reach", "-o", "reach.npz", path=scripts)
    assert json.loads(run(folder, scripts / "trajopt", "check", "reach.npz", "--json", path=scripts))["ok"]
    run(folder, scripts / "trajopt", "plot", "reach.npz", "-o", "reach.png", path=scripts)
    assert (folder / "reach.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_own_files_named_as_folders_of_the_repository_disturb_nothing(folder: Path) -> None:
    solves_both_ways(folder, Path(sys.executable).parent)


def installed(uv: str, folder: Path, name: str, wheel: Path, *options: str | Path) -> Path:
    """The programs of a new environment of that name with this wheel."""
    run(folder, uv, "venv", "--python", sys.executable, folder / name)
    run(folder, uv, "pip", "install", "--python", folder / name, *options, wheel)
    return folder / name / "bin"


def says_what_it_is_for(wheel: Path) -> None:
    """Nothing is installed that collides with a user's files; Python and platform are stated."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    folders = {name.split("/")[0] for name in names}
    assert {name for name in folders if not name.endswith(".dist-info")} == {"trajopt", "trajopt_library"}
    assert "trajopt/py.typed" in names
    lines = metadata.splitlines()
    assert {"Name: trajopt-contacts", "Classifier: Operating System :: POSIX :: Linux"} <= set(lines)
    assert any(line.startswith("Requires-Python: ") for line in lines)
    # Extensions are for one Python and one platform.
    python, _, platform = wheel.stem.split("-")[2:]
    assert python == f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert platform.startswith("manylinux_2_")


# One test, since the wheel takes minutes to build and workers share nothing.
@pytest.mark.slow
def test_wheel_solves_in_new_environments_with_the_locked_and_with_the_lowest_versions(
    folder: Path, tmp_path: Path
) -> None:
    uv = os.environ.get("UV") or shutil.which("uv")  # `uv run` names itself
    assert uv is not None, "uv is needed, as for every command of the README"
    build = sys.executable, "-m", "scripts.wheels", "--python", sys.executable
    run(ROOT, *build, "--output", tmp_path / "dist")
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    says_what_it_is_for(wheel)
    locked = tmp_path / "locked.txt"
    run(ROOT, uv, "export", "--locked", "--no-default-groups", "--no-emit-project", "--output-file", locked)
    solves_both_ways(folder, installed(uv, folder, "locked", wheel, "--requirements", locked))
    solves_both_ways(folder, installed(uv, folder, "lowest", wheel, "--resolution", "lowest-direct"))
