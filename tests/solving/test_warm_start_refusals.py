"""Starts that cannot be mapped, and solutions whose multipliers are damaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import trajopt
from tests.support.problems import FOOT, hop, hopper, reach
from tests.support.solved_problems import SAME_STATE, solved_hop
from trajopt.errors import InputError, SolutionFileError
from trajopt.schedule.schedule import Phase, Schedule
from trajopt.solving.solving import prepare
from trajopt.solving.warm_start import warm_start
from trajopt.terms import FrameHeight, TorqueCost


def test_another_robot_is_refused():
    t = prepare(reach()).transcription
    with pytest.raises(InputError, match=r"'hopper' has other joints than 'arm'"):
        warm_start(t, solved_hop().solution)


def test_other_phases_are_refused():
    stand = hop(schedule=Schedule((Phase(name="stance", duration=0.3, contacts=(FOOT,)),)),
                terms=(TorqueCost(weight=1.0),))  # fmt: skip
    t = prepare(stand, intervals=4).transcription
    with pytest.raises(InputError, match="phases"):
        warm_start(t, solved_hop().solution)


def test_phases_of_other_names_are_mapped_by_order():
    phases = tuple(replace(phase, name=f"{phase.name} again") for phase in hop().schedule.phases)
    terms = tuple(term for term in hop().terms if not isinstance(term, FrameHeight))
    renamed = hop(schedule=Schedule(phases), terms=terms)
    t = prepare(renamed, transcription="legendre:2", intervals=8).transcription
    assert_allclose(warm_start(t, solved_hop().solution).x, solved_hop().result.x, atol=SAME_STATE)


@pytest.mark.parametrize("start", [5, {}, b"file"])
def test_a_start_that_is_no_solution_is_refused(start):
    with pytest.raises(InputError, match="is not a solution; allowed: a Solution or the path"):
        trajopt.solve(reach(), start=start, fixed_mesh=True)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SolutionFileError, match="does not exist"):
        trajopt.solve(reach(), start=tmp_path / "none.npz", fixed_mesh=True)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"row_place": None}, "come together"),
        ({"row_multiplier": np.zeros(3)}, "row_place"),
        ({"bound_multiplier": np.full(5, np.nan)}, "NaN"),
    ],
)
def test_damaged_multipliers_are_refused(changes, words, tmp_path):
    damaged = replace(solved_hop().solution, **changes)
    with pytest.raises(InputError, match=words):
        damaged.save(tmp_path / "damaged.npz")


def test_multipliers_of_rows_that_are_nowhere_are_left_out():
    case = solved_hop()
    place = case.solution.row_place.copy()
    place[-1, 1] = 10_000
    strange = replace(case.solution, row_place=place)
    assert warm_start(case.transcription, strange).multipliers is None
    assert hopper().name == strange.description.robot
