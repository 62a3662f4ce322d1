"""The command ``trajopt simulate``: exit status, JSON, files, one line for bad input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from tests.support.command_lines import assert_refused, invoke
from tests.support.synthetic_motions import sampled, standing
from trajopt import Solution
from trajopt_library import robots

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def stand(tmp_path_factory) -> Path:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot, 0.1)], 4).save(tmp_path_factory.mktemp("plan") / "stand.npz")


@pytest.fixture(scope="module")
def limp(stand: Path) -> Path:
    """The same posture without torques."""
    plan = Solution.load(stand)
    return replace(plan, tau=np.zeros_like(plan.tau)).save(stand.parent / "limp.npz")


def run(*arguments: object) -> Result:
    return invoke("simulate", *arguments)


def test_tracked_plan_ends_with_zero_and_says_so(stand):
    result = run(stand)
    assert result.exit_code == 0
    assert result.output.splitlines()[-1] == "tracked"


def test_robot_that_falls_ends_with_one_and_the_reason(limp):
    result = run(limp, "--kp", 0, "--kd", 0)
    assert result.exit_code == 1
    assert result.output.splitlines()[-1].startswith("not tracked: ")


def test_json_is_one_object_with_the_figures_of_the_report(stand):
    result = run(stand, "--json")
    figures = json.loads(result.output)
    assert figures["passed"] is True
    assert figures["fell"] is False
    assert figures["base_error_end"] < 1e-3
    assert [contact["frame"] for contact in figures["contacts"]] == Solution.load(stand).meta[
        "contact_frames"
    ]


def test_simulated_motion_is_written_as_a_solution_file(stand, tmp_path):
    target = tmp_path / "simulated.npz"
    assert run(stand, "-o", target).exit_code == 0
    assert Solution.load(target).statistics.simulated is True


def test_page_shows_plan_and_simulation(stand, tmp_path):
    target = tmp_path / "both.html"
    assert run(stand, "--html", target).exit_code == 0
    page = target.read_text()
    assert "plan" in page
    assert "simulation" in page
    assert page.count("<html") == 1


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["missing.npz"], "missing.npz does not exist"),
        (
            ["PLAN", "--kp", "-1"],
            "kp of SimulationSettings is -1.0; allowed: a finite number from 0 to 1e+06",
        ),
        (["PLAN", "--cycles", "0"], "cycles of SimulationSettings is 0; allowed: a whole number >= 1"),
        (["PLAN", "--cycles", "2"], "the solution is not periodic; allowed: --cycles 1"),
        (["PLAN", "-o", "PLAN"], "is an input file"),
        (["PLAN", "-o", "x.npz", "--html", "./x.npz"], "x.npz is written twice"),
        (["PLAN", "--noise", "a lot"], "Invalid value for '--noise'"),
        (["PLAN", "-o", "/no/such/folder/x.npz"], "cannot write /no/such/folder/x.npz"),
        (["PLAN", "--html", "/no/such/folder/x.html"], "cannot write /no/such/folder/x.html"),
    ],
)
def test_bad_input_ends_with_two_and_one_line(arguments, line, stand):
    assert_refused(run(*[stand if word == "PLAN" else word for word in arguments]), line)
