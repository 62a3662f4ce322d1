"""The package beside a user's own files and as a wheel, and what it says of itself."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import trajopt
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


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
# What is compiled against: at run time exactly these versions.
COMPILED_AGAINST = {"casadi", "libpinocchio", "libcoal", "cmeel-boost"}
PYTHON = "Programming Language :: Python :: 3."
# pip would find the other project `trajopt` of PyPI, or nothing.
INSTALLS = re.compile(r"\b(?:pip install|uv add|uvx)\b([^\n`]*)")


def test_python_versions_are_those_of_the_classifiers_and_of_the_locked_wheels() -> None:
    low, high = map(int, re.findall(r"3\.(\d+)", PROJECT["project"]["requires-python"]))
    named = [name for name in PROJECT["project"]["classifiers"] if name.startswith(PYTHON)]
    assert sorted(int(name.removeprefix(PYTHON)) for name in named) == list(range(low, high))
    (pin,) = (
        package
        for package in tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]
        if package["name"] == "pin"
    )
    wheels = {minor for wheel in pin["wheels"] for minor in re.findall(r"-cp3(\d+)-", wheel["url"])}
    assert wheels >= {str(minor) for minor in range(low, high)}


def test_only_what_is_compiled_against_is_pinned() -> None:
    built = {
        entry for entry in PROJECT["build-system"]["requires"] if entry.split("==")[0] in COMPILED_AGAINST
    }
    pinned = {entry for entry in PROJECT["project"]["dependencies"] if "==" in entry}
    (pin,) = (entry.split("==")[1] for entry in built if entry.startswith("libpinocchio"))
    assert pinned == built | {f"pin=={pin}"}


def test_versions_and_licences_agree() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = PROJECT["project"]
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= citation.keys(), "the fields that the format requires"
    assert citation["version"] == project["version"] == trajopt.__version__
    assert citation["license"] == project["license"]
    assert [author["name"] for author in citation["authors"]] == [a["name"] for a in project["authors"]]


@pytest.mark.parametrize("folder", ["trajopt", "problems", "robots", "docs", "notebooks", "."])
def test_no_advice_installs_another_project_of_this_name(folder: str) -> None:
    every = folder != "."
    files = [
        path
        for suffix in ("py", "md", "ipynb", "toml")
        for path in ((ROOT / folder).rglob(f"*.{suffix}") if every else (ROOT / folder).glob(f"*.{suffix}"))
    ]
    assert files
    for path in files:
        for words in INSTALLS.findall(path.read_text(encoding="utf-8")):
            own = [word.strip("'\"") for word in words.split("#")[0].split() if "trajopt" in word]
            assert all(word.startswith("./") for word in own), f"{path.relative_to(ROOT)}: {words}"
