"""Images of a periodic plan's samples: together they are the image that closes the plan."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.exported_plans import GAITS, ROUNDING, plan_to_export, swinging_arm
from tests.support.refusals import assert_refused_in_one_line
from trajopt.motion.cycles import CycleImage, passes_of, periodic_image

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
        assert_allclose(q[row], own[0], atol=ROUNDING)
        assert_allclose(v[row], own[1], atol=ROUNDING)
        assert pin.isNormalized(plan.model, q[row], ROUNDING)


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
    assert_allclose(q[:, :3], plan.q[:, :3] + ahead, atol=ROUNDING)
    assert_allclose(q[:, 7:], plan.q[:, 7:], atol=ROUNDING)
    assert_allclose(v, plan.v, atol=ROUNDING)
    f = image.of_contact_forces(image.of_contact_forces(plan.f))
    assert_allclose(f, plan.f, atol=ROUNDING)
    assert_allclose(image.of_torques(image.of_torques(plan.tau)), plan.tau, atol=ROUNDING)
