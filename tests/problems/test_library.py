"""Every problem of the library on one robot, and every robot on one problem, against their regression data.

The subset is chosen by a rule (`representatives`); ``trajopt suite --compare tests/data/suite.csv`` runs all.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.repository import ROOT
from tests.support.solved_problems import motion
from trajopt.problem.catalogue import families
from trajopt.study.suite import data
from trajopt.study.suite.cases import Case, all_cases
from trajopt.study.suite.outcome import Outcome
from trajopt.study.suite.run import SuiteSettings, attempt

DATA = ROOT / "tests" / "data" / "suite.csv"
SETTINGS = SuiteSettings()
CASES = all_cases(families())
# Iterations on all meshes that a pair may take at most to be run here.
MOST_ITERATIONS = 300
UPDATE = f"trajopt bench suite --update {DATA.relative_to(ROOT)}"


def representatives(cases: Sequence[Case]) -> tuple[Case, ...]:
    """A subset with every problem once and every robot at least once, the same on every machine.

    Problems in order of their number of robots, then by name: each takes the robot that has been taken
    least often, of equals the first by name. Robots that are left then take their first problem. Pairs that
    may take very many iterations are left to the whole suite, where their problem has another robot.
    """
    bands = data.read(DATA)[0]
    by_problem: dict[str, list[Case]] = {}
    for case in sorted(cases):
        by_problem.setdefault(case.problem, []).append(case)
    for problem, group in by_problem.items():
        known = [case for case in group if case.name in bands]
        quick = [case for case in known if bands[case.name].iterations_high <= MOST_ITERATIONS]
        by_problem[problem] = quick or group
    taken: Counter[str] = Counter()
    chosen = []
    for group in sorted(by_problem.values(), key=len):
        case = min(group, key=lambda one: taken[one.robot])
        taken[case.robot] += 1
        chosen.append(case)
    for case in sorted(case for group in by_problem.values() for case in group):
        if not taken[case.robot]:
            taken[case.robot] += 1
            chosen.append(case)
    return tuple(sorted(chosen))


def test_representatives_hold_every_problem_and_every_robot():
    chosen = representatives(CASES)
    assert {one.problem for one in chosen} == {one.problem for one in CASES}
    assert {one.robot for one in chosen} == {one.robot for one in CASES}
    assert (
        len(chosen)
        == len(set(chosen))
        <= len({one.problem for one in CASES}) + len({one.robot for one in CASES})
    )
    assert representatives(CASES[::-1]) == chosen


@pytest.mark.slow
@pytest.mark.parametrize("case", representatives(CASES), ids=lambda case: case.name)
def test_pair_is_solved_and_checked_within_its_bands(case: Case) -> None:
    solution = motion(case.family, **case.values)
    own = attempt(solution, None, legged=False)
    outcome = Outcome(problem=case.problem, robot=case.robot, own=own)
    entries, _ = data.read(DATA)
    assert data.deviation(outcome, SETTINGS, entries.get(case.name)) == ""


def test_every_pair_has_its_bands() -> None:
    entries, _ = data.read(DATA)
    assert set(entries) == {case.name for case in CASES}, f"run: {UPDATE}"


def test_data_are_as_they_are_written(tmp_path: Path) -> None:
    """Sorted and padded, so that a change of one band is a change of one line."""
    entries, versions = data.read(DATA)
    data.write_bands(tmp_path / "suite.csv", entries, versions)
    assert (tmp_path / "suite.csv").read_text() == DATA.read_text()
