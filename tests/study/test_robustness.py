"""Statistics over perturbed starts: optima told apart by objective and motion, and runs that go on."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from tests.support import suite_problems
from tests.support.packages import installed
from tests.support.problems import hop, hopper, planar_hopper, reach
from trajopt import solve
from trajopt.study.suite.cases import Case
from trajopt.study.suite.engine import SuiteRecords, run_suite
from trajopt.study.suite.optima import SAME_MOTION, counted, described, distances, embedded
from trajopt.study.suite.outcome import Outcome
from trajopt.study.suite.run import SuiteSettings
from trajopt.study.tasks import open_workers

STARTS = SuiteSettings(perturbed=3)
CASE = Case(problem="t-reach", robot="arm", takes_robot=False)
# Single precision of what is recorded of a motion.
SINGLE = 1e-6


@pytest.fixture(scope="module", autouse=True)
def problems(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tests' own families beside the library's."""
    with installed(suite_problems, tmp_path_factory.mktemp("package")):
        yield


def motions(values: list[float]) -> list[str]:
    """Motions of one joint that stands still at these angles."""
    solution = solve(reach(), intervals=2)
    return [described(replace(solution, q=np.full_like(solution.q, value))) for value in values]


# Optima


@pytest.mark.parametrize(
    ("objectives", "angles", "optima", "shapes"),
    [
        ([], [], 0, 0),
        ([1.0, 1.0 + 1e-6, 1.0], [0.0, 1e-3, 0.0], 1, 1),  # noise
        ([1.0, 2.0], [0.0, 1.0], 2, 2),
        ([1.0, 1.0], [-1.0, 1.0], 1, 2),  # mirror images
        ([1.0, 1.01], [0.0, 1e-3], 1, 2),  # a flat minimum, not quite reached
        ([1.0, 1.0, 3.0, 3.0 + 1e-7, 2.0], [0.0, 0.0, 1.0, 1.0, 2.0], 3, 3),
        ([-1.0, -2.0, 0.0, 0.0], [0.0, 1.0, 2.0, 2.0], 3, 3),
    ],
)
def test_optima_differ_in_objective_and_motion(objectives, angles, optima, shapes):
    assert counted(objectives, motions(angles)) == (optima, shapes)


def test_runs_without_a_known_motion_go_by_the_objective():
    assert counted([1.0, 1.0 + 1e-7, 2.0], ["", "", ""]) == (2, 2)


def test_the_distance_of_motions_is_the_largest_difference():
    found = distances([*motions([0.1, 0.4]), ""])
    assert found[0, 1] == pytest.approx(0.3, abs=SINGLE)
    assert found[0, 0] == 0.0
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize("robot", [hopper(), planar_hopper()])
def test_configurations_embed_without_their_double_cover(robot):
    generator = np.random.default_rng(0)
    q = pin.integrate(robot.model, robot.reference, generator.standard_normal(robot.nv))
    moved = pin.integrate(robot.model, q, np.full(robot.nv, 1e-4))
    other = q.copy()
    if robot.base == "freeflyer":
        other[3:7] *= -1
    assert embedded(robot.model, other) == pytest.approx(embedded(robot.model, q), abs=1e-12)
    small = np.abs(embedded(robot.model, moved) - embedded(robot.model, q)).max()
    assert 1e-5 < small < SAME_MOTION


def test_solves_of_one_problem_from_two_starts_are_one_optimum():
    runs = [solve(hop(), seed=seed, perturb=0.05, fixed_mesh=True) for seed in (0, 1)]
    assert all(run.converged for run in runs)
    objectives = [run.statistics.objective for run in runs]
    apart = distances([described(run) for run in runs])[0, 1]
    optima, shapes = counted(objectives, [described(run) for run in runs])
    close = abs(objectives[0] - objectives[1]) < 1e-4 * max(objectives)
    assert optima == (1 if close or apart <= SAME_MOTION else 2)
    assert shapes == (1 if close and apart <= SAME_MOTION else 2)


# Runs that go on


class Interrupted(SuiteRecords):
    """Records that are interrupted after so many starts."""

    def interrupt_after(self, most: int) -> list[int]:
        self.most, self.starts = most, list[int]()
        return self.starts

    def add_event(self, pair: str, event: dict[str, Any]) -> None:
        super().add_event(pair, event)
        if event["event"] == "start":
            self.starts.append(event["values"]["seed"])
            if len(self.starts) == self.most:
                raise KeyboardInterrupt


def pursue(folder: Path, most: int) -> tuple[list[Outcome], list[int]]:
    records = Interrupted(folder, STARTS, {"version": "1"})
    records.open(resume=True)
    starts = records.interrupt_after(most)
    try:
        with open_workers(jobs=1) as workers:
            outcomes = list(run_suite([CASE], STARTS, records, workers))
    except KeyboardInterrupt:
        outcomes = []
    for outcome in outcomes:
        records.add(outcome)
    return outcomes, starts


@pytest.mark.long
def test_a_pair_that_was_interrupted_goes_on_with_the_starts_that_are_left(tmp_path):
    assert pursue(tmp_path, 2) == ([], [0, 1])
    (found,), starts = pursue(tmp_path, 99)
    assert starts == [2]
    assert found.ok
    assert [start.seed for start in found.starts] == [0, 1, 2]
    assert all(start.solved and start.motion for start in found.starts)
    figures = found.perturbed()
    assert (figures.count, figures.solved, figures.optima, figures.motions) == (3, 3, 1, 1)
    assert figures.most_iterations == max(start.iterations for start in found.starts)
    again, starts = pursue(tmp_path, 99)
    assert (starts, again[0].starts) == ([], found.starts)


def test_events_of_other_settings_or_damaged_ones_are_not_taken(tmp_path):
    pursue(tmp_path, 1)
    with (tmp_path / "events.jsonl").open("a") as stream:
        stream.write("{no json\n" + json.dumps({"pair": "x", "told": {"event": "start"}}) + "\n")
    assert list(SuiteRecords(tmp_path, STARTS, {"version": "1"}).unfinished()) == [CASE.name]
    assert SuiteRecords(tmp_path, replace(STARTS, sigma=0.2), {"version": "1"}).unfinished() == {}
    SuiteRecords(tmp_path, STARTS, {"version": "1"}).open(resume=False)
    assert SuiteRecords(tmp_path, STARTS, {"version": "1"}).unfinished() == {}
