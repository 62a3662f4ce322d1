"""A solution as a motion at any time, and the local coordinates it is read in."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.models import JOINT_KINDS, hand_built, random_state
from tests.support.problems import SCHEME_ORDERS, hop
from tests.support.solved_problems import ROUNDING, SAME_STATE, solved, solved_hop
from tests.support.symbolic_interpolation import local_from_pinocchio
from trajopt.dynamics.manifold import Coordinates
from trajopt.motion.configurations import motion_of
from trajopt.transcription.guess import initial_guess
from trajopt.transcription.transcription import transcribe


@pytest.mark.parametrize("kind", JOINT_KINDS)
def test_local_coordinates_are_the_inverse_of_pinocchios(kind):
    model, _ = hand_built(kind)
    coordinates = Coordinates(model)
    q, v, a = random_state(model, 3)
    start = coordinates.node_from_pinocchio(*random_state(model, 4)[:2])[: 4 * coordinates.n_rotations]
    local = local_from_pinocchio(coordinates, start, q, v, a)
    back = coordinates.local_to_pinocchio(start[None], *(part[None] for part in local))
    assert_allclose(pin.difference(model, back[0][0], q), 0.0, atol=ROUNDING)
    assert_allclose(back[1][0], v, atol=ROUNDING)
    assert_allclose(back[2][0], a, atol=ROUNDING)


@pytest.mark.long
@pytest.mark.parametrize("name", SCHEME_ORDERS)
def test_motion_of_a_solution_passes_through_its_samples(name):
    case = solved(hop(), name, 6)
    solution, motion = case.solution, motion_of(case.solution)
    inner = [row for row in np.flatnonzero(solution.collocation) if 0 < solution.t[row] < solution.t[-1]]
    nodes = [rows[0] for rows in solution.intervals]
    consistent = name.startswith(("legendre", "radau"))  # others have no polynomial through their points
    for row in (*nodes, *(inner if consistent else [])):
        if solution.t[row] in solution.interval_t and row not in nodes:
            continue  # radau's last point is a node: the next interval's side counts
        apart = pin.difference(solution.model, solution.q[row], motion(float(solution.t[row])))
        assert_allclose(apart, 0.0, atol=SAME_STATE)


def test_rates_of_the_motion_are_the_solutions():
    solution, step = solved_hop().solution, 1e-5
    motion = motion_of(solution)
    for row in np.flatnonzero(solution.collocation):
        t = float(solution.t[row])
        rate = pin.difference(solution.model, motion(t - step), motion(t + step)) / (2 * step)
        # Central differences: step squared times the third derivative, below 1e4 / s^3 here.
        assert_allclose(rate, solution.v[row], atol=1e-5)


def test_motion_holds_its_ends_outside_its_time():
    solution = solved_hop().solution
    motion = motion_of(solution)
    assert_allclose(motion(-1.0), solution.q[0], atol=SAME_STATE)
    assert_allclose(motion(9.0), solution.q[-1], atol=SAME_STATE)


def test_motion_of_a_solution_is_a_guess():
    case = solved_hop()
    t = transcribe(replace(hop(), guess=motion_of(case.solution)), "legendre:2", 8)
    node, form = t.layout.node(3), t.layout.forms[3]
    guess, found = initial_guess(t)[node], case.result.x[node]
    assert_allclose(guess[form.additive], found[form.additive], atol=SAME_STATE)
    # Rates are differences over 1e-3 s, in which accelerations jump from an interval to the next.
    assert_allclose(guess[form.rates], found[form.rates], atol=5e-2)
