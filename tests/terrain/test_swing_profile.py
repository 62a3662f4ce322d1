"""The height that swings are asked for: one in the middle, flat at the ends, with a limit on finer meshes."""

import numpy as np
import pytest

import trajopt
from trajopt.terrain.swing_paths import swing_profile
from trajopt_library import problems

# Relative change of the objective between 50 and 100 intervals; with a profile that rises at once it is 6e-2.
CONVERGED = 1e-3


def test_profile_is_one_in_the_middle_and_flat_at_the_ends():
    s, step = np.linspace(0, 1, 101), 1e-6
    values = np.array([swing_profile(each) for each in s])
    assert values[0] == values[-1] == 0.0
    assert values.max() == values[50] == 1.0
    assert swing_profile(step) / step < 1e-4
    assert (values <= 4 * s * (1 - s) + 1e-12).all()  # what kept the steeper profile keeps this one


@pytest.mark.long
def test_objective_of_a_hop_has_a_limit_on_finer_meshes():
    hop = problems.load("hopper-hop")
    coarse = trajopt.solve(hop, intervals=50)
    fine = trajopt.solve(hop, intervals=100, start=coarse)
    assert fine.converged
    assert fine.statistics.objective == pytest.approx(coarse.statistics.objective, rel=CONVERGED)
