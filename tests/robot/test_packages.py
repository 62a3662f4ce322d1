"""Robots that other packages describe: their names and files, and what is guessed from them."""

import json
import sys
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.mjcf_files import FEET, QUADRUPED
from tests.support.refusals import refusals
from trajopt.inspection.starter import guessed
from trajopt.problem.catalogue import family
from trajopt.robot import robot_file
from trajopt_library import robots

DATA = "example-robot-data"
# Names in the loader of example-robot-data, and robots of the library from the same files.
SAME_FILE = {"anymal": "anymal_b", "anymal_c": "anymal_c", "hyq": "hyq", "ur5": "ur5", "iris": "iris"}


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of mujoco-menagerie that has a small robot for Unitree's Go1, and no server for the others."""
    described = pytest.importorskip("mujoco_menagerie").get("unitree_go1")
    folder = tmp_path / "models" / f"{described.name}-{described.oid[:16]}"
    folder.mkdir(parents=True)
    (folder / "go1.xml").write_text(QUADRUPED)
    (folder / ".complete").write_text("{}")
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MENAGERIE_BASE_URL", (tmp_path / "no-server").as_uri())
    return folder / "go1.xml"


@pytest.mark.long
def test_a_name_is_the_robot_guessed_from_its_description() -> None:
    found = trajopt.robot(f"{DATA}:romeo")
    same = guessed(robot_file("romeo_description/urdf/romeo.urdf"))
    assert (found.name, found.base, found.nq, len(found.contacts)) == ("romeo", "freeflyer", 38, 2)
    assert found.mass == pytest.approx(same.mass)
    assert_array_equal(found.reference, same.reference)
    assert robots.kind(f"{DATA}:romeo") == "biped"
    assert robots.tool_frame(f"{DATA}:ur10") == robots.tool_frame("ur5")


@pytest.mark.long
@pytest.mark.parametrize("name", SAME_FILE)
def test_names_of_the_loader_are_the_files_that_it_loads(name: str) -> None:
    assert trajopt.robot(f"{DATA}:{name}").mass == pytest.approx(robots.load(SAME_FILE[name]).mass)


def test_problems_batches_and_suites_take_the_names() -> None:
    name = f"{DATA}:go1"
    problem = trajopt.load("quadruped-trot", robot=name)
    assert (problem.robot.name, problem.parameters["robot"]) == ("go1", name)
    assert family("quadruped-trot").of_file(problem.parameters)["robot"] == name
    assert "quadruped-trot" in invoke("list", "--robot", name).stdout


def test_a_robot_of_menagerie_is_read_from_the_cache(cached: Path) -> None:
    found, keyframe = trajopt.robot("menagerie:unitree_go1"), guessed(cached)
    assert (found.name, [contact.frame for contact in found.contacts]) == ("unitree_go1", list(FEET))
    assert_array_equal(found.reference, keyframe.reference)
    assert found.visual is not None
    assert found.visual.urdf == cached
    assert robots.kind("menagerie:unitree_go1") == "quadruped"


@pytest.mark.long
def test_the_command_shows_and_writes_robots_of_packages(cached: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    assert invoke("robot", "menagerie:unitree_go1", "--write", mine).stdout.startswith(
        "unitree_go1: freeflyer"
    )
    assert_array_equal(robots.load(str(mine)).contacts, guessed(cached).contacts)
    assert invoke("robot", f"{DATA}:z1", "--base", "freeflyer").stdout.startswith("z1_description: freeflyer")
    assert "guess: wheels, locked" in invoke("robot", f"{DATA}:tiago_no_hand").stdout


def test_robots_are_listed_by_kind_and_package(cached: Path) -> None:
    listed = json.loads(invoke("list", "--robots", "--json").stdout)["robots"]
    assert listed["quadruped"] == list(robots.names("quadruped"))
    assert {"romeo", "talos_full", "ur10_limited"} < set(listed[f"{DATA}:NAME"])
    assert "unitree_go1" in listed["menagerie:NAME"]
    assert "hopper: hopper, hopper_space" in invoke("list", "--robots").stdout
    assert_refused(invoke("list", "--robots", "--brief"), "allowed: alone, or with --json")


test_unknown_names_are_refused_with_the_likely_one = refusals(
    trajopt.robot,
    ("go3", "did you mean go2?"),
    ("romeo", f"did you mean {DATA}:romeo?"),
    (f"{DATA}:rome", "'rome' of example-robot-data is unknown; did you mean romeo?"),
    ("data:romeo", "package 'data' of robot 'data:romeo' is unknown; .*example-robot-data:NAME"),
    (f"{DATA}:cassie", "is described in SDF, which is not read; allowed: URDF or MJCF"),
)


@pytest.mark.usefixtures("cached")
def test_robots_of_menagerie_that_are_unknown_or_out_of_reach_are_refused_in_one_line() -> None:
    assert_refused(invoke("robot", "menagerie:go2"), "did you mean unitree_go2?")
    refused = invoke("solve", "quadruped-trot", "--set", "robot=menagerie:unitree_a1")
    assert_refused(refused, "cannot be downloaded", "mujoco-menagerie prefetch unitree_a1")
    assert_refused(invoke("bench", "suite", "--robots", "menagerie:a1"), "'a1' of menagerie is unknown")


def test_menagerie_that_is_not_installed_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    assert_refused(invoke("robot", "menagerie:unitree_go1"), "or the extra 'menagerie'")
    assert "menagerie:NAME" not in invoke("list", "--robots").stdout
