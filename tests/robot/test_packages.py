"""Robots that other packages describe: their names and files, and what is guessed from them."""

import json
import sys
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

import trajopt
from tests.support.command_lines import assert_refused, invoke
from tests.support.mjcf_files import QUADRUPED
from tests.support.refusals import refusals
from trajopt.inspection.starter import guessed
from trajopt.problem.catalogue import family
from trajopt.robot import robot_file
from trajopt_library import robots

DATA = "example-robot-data"


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
    found, same = trajopt.robot(f"{DATA}:romeo"), guessed(robot_file("romeo_description/urdf/romeo.urdf"))
    assert (found.name, found.base, robots.kind(f"{DATA}:romeo")) == ("romeo", "freeflyer", "biped")
    assert_array_equal(found.reference, same.reference)
    for name in ("anymal_c", "hyq", "iris", "ur5"):  # files that the loader calls otherwise
        assert trajopt.robot(f"{DATA}:{name}").mass == pytest.approx(robots.load(name).mass)


def test_problems_batches_and_suites_take_the_names() -> None:
    name = f"{DATA}:go1"
    problem = trajopt.load("quadruped-trot", robot=name)
    assert (problem.robot.name, problem.parameters["robot"]) == ("go1", name)
    assert family("quadruped-trot").of_file(problem.parameters)["robot"] == name
    assert "quadruped-trot" in invoke("list", "--robot", name).stdout


@pytest.mark.long
def test_a_robot_of_menagerie_is_read_from_the_cache_and_written(cached: Path, tmp_path: Path) -> None:
    name, mine = "menagerie:unitree_go1", tmp_path / "mine.py"
    found, same = trajopt.robot(name), guessed(cached)
    assert_array_equal(found.reference, same.reference)
    assert invoke("robot", name, "--write", mine).stdout.startswith("unitree_go1: freeflyer")
    assert robots.load(str(mine)).contacts == same.contacts


def test_robots_are_listed_by_kind_and_package(cached: Path) -> None:
    listed = json.loads(invoke("list", "--robots", "--json").stdout)["robots"]
    assert listed["quadruped"] == list(robots.names("quadruped"))
    assert {"romeo", "ur10_limited", "unitree_go1"} < {*listed[f"{DATA}:NAME"], *listed["menagerie:NAME"]}


test_unknown_names_are_refused_with_the_likely_one = refusals(
    trajopt.robot,
    ("go3", "did you mean go2?"),
    ("romeo", f"did you mean {DATA}:romeo?"),
    (f"{DATA}:rome", "'rome' of example-robot-data is unknown; did you mean romeo?"),
    ("data:romeo", "package 'data' of robot 'data:romeo' is unknown; .*example-robot-data:NAME"),
    (f"{DATA}:cassie", "is described in SDF, which is not read; allowed: URDF or MJCF"),
)


def test_robots_of_menagerie_out_of_reach_are_refused_in_one_line(cached: Path, monkeypatch) -> None:
    assert_refused(invoke("bench", "suite", "--robots", "menagerie:go2"), "did you mean unitree_go2?")
    done = invoke("solve", "quadruped-trot", "--set", "robot=menagerie:unitree_a1")
    assert_refused(done, "cannot be downloaded", "mujoco-menagerie prefetch unitree_a1")
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    assert_refused(invoke("robot", "menagerie:unitree_go1"), "or the extra 'menagerie'")
