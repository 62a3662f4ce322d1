"""What the package says of itself: Python versions, platforms, citation, and no advice to install another."""

import re
import tomllib

import pytest
import yaml

import trajopt
from tests.support.repository import ROOT

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
