"""What functions that show or run solutions take."""

from dataclasses import replace

import pytest

from tests.support.replay_pages import hopping
from trajopt.errors import InputError
from trajopt.solution.input import require_motion, solutions_of
from trajopt.solution.solution import Solution


@pytest.fixture(scope="module")
def hop() -> Solution:
    return hopping()


def test_one_solution_its_file_and_several_are_taken(hop, tmp_path):
    hop.save(tmp_path / "hop.npz")
    assert solutions_of(hop) == [hop]
    assert [one.n_samples for one in solutions_of([hop, tmp_path / "hop.npz"])] == [hop.n_samples] * 2


def test_what_is_no_solution_is_named():
    with pytest.raises(InputError, match=r"3.5 is not a solution; allowed: a Solution or the path"):
        solutions_of(3.5)


def test_sample_without_a_rotation_is_named(hop):
    q = hop.q.copy()
    q[4, 3:7] = 0.0
    with pytest.raises(InputError, match="holds no rotation at sample 4; allowed: unit norms"):
        require_motion(replace(hop, q=q))
    q[4] = hop.q[4] * (1 + 1e-6)
    assert require_motion(replace(hop, q=q)).n_samples == hop.n_samples
