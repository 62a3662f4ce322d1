"""A solution as a motion at any time, and images of a periodic plan's samples."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.exported_plans import GAITS, plan_to_export, swinging_arm
from tests.support.exported_plans import ROUNDING as PLANNED
from tests.support.models import JOINT_KINDS, hand_built, random_state
from tests.support.problems import SCHEME_ORDERS, hop
from tests.support.refusals import assert_refused_in_one_line
from tests.support.solved_problems import ROUNDING, SAME_STATE, solved, solved_hop
from tests.support.symbolic_interpolation import local_from_pinocchio
from trajopt.dynamics.manifold import Coordinates
from trajopt.motion.configurations import motion_of
from trajopt.motion.cycles import CycleImage, passes_of, periodic_image
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


# A plan closes within the solver's tolerance.
CLOSING = 1e-5


@pytest.mark.parametrize("kind", GAITS)
def test_images_of_many_states_are_those_of_each(kind: str) -> None:
    plan = plan_to_export(kind)
    image = CycleImage.of(plan)
    q, v = image.of_states(plan.q, plan.v)
    for row in range(0, plan.n_samples, 7):
        own = periodic_image(
            plan.model, plan.description.periodicity, plan.q[row], plan.v[row], image.duration
        )
        assert_allclose(q[row], own[0], atol=PLANNED)
        assert_allclose(v[row], own[1], atol=PLANNED)
        assert pin.isNormalized(plan.model, q[row], PLANNED)


@pytest.mark.parametrize("kind", GAITS)
def test_the_image_of_the_start_is_the_end(kind: str) -> None:
    plan = plan_to_export(kind)
    q, v = CycleImage.of(plan).of_states(plan.q[:1], plan.v[:1])
    assert np.abs(pin.difference(plan.model, q[0], plan.q[-1])).max() < CLOSING
    assert np.abs(v[0] - plan.v[-1]).max() < CLOSING


@pytest.mark.long
def test_a_mirrored_plan_is_gone_through_twice_a_cycle() -> None:
    assert passes_of(plan_to_export("mirrored walk"), 3) == 6
    assert passes_of(plan_to_export("turning trot"), 3) == 3
    assert passes_of(swinging_arm(), 1) == 1
    assert_refused_in_one_line(lambda: passes_of(swinging_arm(), 2), "not periodic; allowed: `cycles=1`")


def test_two_mirror_images_are_the_motion_moved_ahead() -> None:
    plan = plan_to_export("mirrored walk")
    image = CycleImage.of(plan)
    q, v = image.of_states(*image.of_states(plan.q, plan.v))
    ahead = 2 * image.duration * np.array(plan.description.periodicity.velocity)
    assert_allclose(q[:, :3], plan.q[:, :3] + ahead, atol=PLANNED)
    assert_allclose(q[:, 7:], plan.q[:, 7:], atol=PLANNED)
    assert_allclose(v, plan.v, atol=PLANNED)
    motion = plan.sample()
    back = image.of_motion(image.of_motion(motion))
    for name in ("a", "tau", "drive_torque", "f", "active"):
        assert_allclose(getattr(back, name), getattr(motion, name), atol=PLANNED)
