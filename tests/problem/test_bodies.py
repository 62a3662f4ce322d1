"""Which bodies of a problem must stay apart, by how much, and which starts are refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import trajopt
from tests.support.ground import HILLS, STAIRS
from tests.support.refusals import refused, refused_calls
from tests.support.swings import BALL, FAR, MARGIN, ROD_CAPSULES, past, rods, swing
from trajopt import FlatGround, InputError, Problem, start_of
from trajopt.collision import robot_shapes
from trajopt.collision.description import sampled_postures
from trajopt.collision.near import GROUND
from trajopt.collision.shapes import LinkShape, SphereObstacle
from trajopt.problem.bodies import FOOT_DEPTH, GAP_SLACK, MORE_DEPTH, ProblemBodies, bodies_of, clearance_of
from trajopt.problem.problem import rest
from trajopt.solving.extraction import described_bodies
from trajopt.terms import Clearance, FramePose, Term, TerminalPosture, TerminalState
from trajopt_library import robots

EXACT = 1e-8  # m; what Coal's iterations leave for balls and capsules


def standing(robot: str = "solo12", clearance: Clearance | None = None) -> Problem:
    """A robot at rest on level ground."""
    problem = replace(rest(robots.load(robot)), terrain=FlatGround())
    return problem if clearance is None else replace(problem, terms=(*problem.terms, clearance))


def margins(problem: Problem) -> dict[tuple[str, str], float]:
    found = bodies_of(problem)
    return dict(zip(found.pairs, found.margins.tolist(), strict=True))


@pytest.mark.parametrize(("robot", "feet"), [("solo12", 4), ("go2", 4), ("talos", 2)])
def test_feet_may_be_on_the_ground_and_other_links_not_in_it(robot, feet):
    problem = standing(robot)
    scene = bodies_of(problem).scene
    deep = {
        pair: float(distance)
        for pair, distance in zip(scene.pairs, scene.distances(problem.initial_q)[0], strict=True)
    }
    found = margins(problem)
    touching = {pair for pair, margin in found.items() if margin < 0}
    assert {pair[1] for pair in touching} == {GROUND}
    assert len(touching) >= feet
    for pair in touching:
        assert found[pair] == pytest.approx(min(deep[pair] - MORE_DEPTH, -FOOT_DEPTH), abs=EXACT)
    assert all(found[pair] == 0.0 for pair in found if pair not in touching)
    assert len(touching) < scene.n_ground / 2


def test_obstacles_and_links_keep_the_margin_and_the_ground_does_not():
    far = SphereObstacle(name="far", centre=[3.0, 0.0, 0.0], radius=0.1)
    problem = standing(clearance=Clearance(obstacles=(far,), margin=0.004))
    scene, found = bodies_of(problem).scene, margins(problem)
    assert {found[pair] for pair in scene.pairs[scene.n_ground : scene.n_outer]} == {0.004}
    assert {found[pair] for pair in scene.self_pairs} == {0.004}
    assert max(found[pair] for pair in scene.pairs[: scene.n_ground]) == 0.0


def test_two_links_keep_no_more_than_in_the_reference_posture():
    problem = standing(clearance=Clearance(margin=0.1))
    scene, found = bodies_of(problem).scene, margins(problem)
    apart = scene.distances(problem.robot.reference)[0, scene.n_outer :]
    assert apart.min() < 0.1 < apart.max()
    expected = np.minimum(apart, 0.1)
    assert [found[pair] for pair in scene.self_pairs] == pytest.approx(expected)
    described = described_bodies(problem)["margins"]
    assert (described.obstacles, described.pairs.tolist()) == (0.1, pytest.approx(expected))


def test_links_that_touch_are_those_around_contacts_whatever_else_is_fixed():
    robot = robots.load("solo12")
    shapes = robot_shapes(robot).shapes
    post = LinkShape.sphere("post", "universe", np.array([5.0, 0.0, 1.0]), 0.1)
    problem = standing()
    without = margins(replace(problem, terms=(Clearance(shapes=shapes),)))
    first = margins(replace(problem, terms=(Clearance(shapes=(post, *shapes)),)))
    assert {pair: first[pair] for pair in without} == without
    assert ("post", GROUND) not in first


def test_two_clearances_are_refused():
    problem = past(past(swing(), BALL), FAR)
    with pytest.raises(InputError, match="2 clearance terms; allowed: one"):
        clearance_of(problem)
    assert clearance_of(swing()).obstacles == ()


def test_self_collision_can_be_left_out():
    free = bodies_of(standing(clearance=Clearance(self_collision=False)))
    assert free.scene.self_pairs == ()
    assert free.pairs == bodies_of(standing()).pairs[: free.scene.n_ground]


@pytest.mark.long
def test_shapes_given_by_hand_replace_those_of_the_description():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    problem = past(swing(robot=robot), BALL, self_collision=True)
    assert bodies_of(problem).scene.self_pairs == (("joint0", "joint2"),)
    shapes = robot_shapes(robots.load("solo12")).shapes[:4]
    given = bodies_of(standing(clearance=Clearance(shapes=shapes, self_collision=False)))
    assert given.scene.shapes == shapes


def test_robot_without_shapes_has_no_pairs():
    found = bodies_of(swing())
    assert found.pairs == ()
    assert found.widest == 0.0
    assert described_bodies(swing())["bodies"] is None


def test_ground_is_not_solid_to_a_pendulum():
    assert bodies_of(past(swing(), BALL)).scene.n_ground == 0
    raised = tuple(replace(s, points=s.points + 0.1 * np.eye(3)[2]) for s in ROD_CAPSULES)
    higher = swing(end=np.array([0.6, 0.0, 0.0]))
    assert bodies_of(past(higher, FAR, shapes=raised)).scene.n_ground == len(raised)


def test_start_too_near_an_obstacle_is_refused_in_one_line():
    near = SphereObstacle(name="near", centre=[-0.3, 0.0, 1.2], radius=0.1)
    with refused(r"starts .* m from 'near' .*; allowed: at least 0.02 m"):
        bodies_of(past(swing(), near))


def beside_the_start(gap: float) -> Problem:
    """The swing beside a ball that is ``gap`` m from the last rod at the start."""
    problem = swing()
    (rod,) = (shape for shape in ROD_CAPSULES if shape.name == "joint2")
    middle = np.array([np.sin(-0.3), 0.0, np.cos(-0.3)]) * 1.25
    centre = middle + (rod.radius + 0.1 + gap) * np.array([0.0, 1.0, 0.0])
    return past(problem, SphereObstacle(name="near", centre=centre, radius=0.1))


def test_start_may_be_as_near_as_a_look_allows_and_no_nearer():
    assert isinstance(bodies_of(beside_the_start(MARGIN - 0.9 * GAP_SLACK)), ProblemBodies)
    with pytest.raises(InputError, match="from 'near'"):
        bodies_of(beside_the_start(MARGIN - 1.1 * GAP_SLACK))


def ending(*terms: Term, shapes: Sequence[LinkShape] | None = None, **changes: object) -> Problem:
    """The swing past a ball that lies before it, which ends as the terms say."""
    problem = past(swing(), LYING, **({} if shapes is None else {"shapes": shapes}))
    kept = [term for term in problem.terms if not isinstance(term, TerminalState)]
    return replace(problem, terms=(*kept, *terms), **changes)


def test_final_configuration_in_an_obstacle_is_refused_in_one_line():
    message = r"'joint1' in q of terminal_state is -0\..* m from 'lying' .*; allowed: at least 0.02 m"
    with refused(message):
        bodies_of(past(swing(), LYING))
    assert bodies_of(past(swing(end=np.array([0.6, 0.0, 0.0])), LYING)).pairs


def test_final_configuration_may_be_as_near_as_a_look_allows_and_no_nearer():
    def above_the_ball(gap: float) -> Problem:
        problem = swing(end=np.array([np.pi / 2, 0.0, 0.0]))
        thickness = next(s.radius for s in ROD_CAPSULES if s.name == "joint2")
        centre = np.array([1.25, 0.0, -(thickness + 0.1 + gap)])
        return past(problem, SphereObstacle(name="near", centre=centre, radius=0.1))

    assert bodies_of(above_the_ball(MARGIN - 0.9 * GAP_SLACK)).pairs
    with pytest.raises(InputError, match=r"in q of terminal_state is .* from 'near'"):
        bodies_of(above_the_ball(MARGIN - 1.1 * GAP_SLACK))


def test_final_configuration_with_links_in_each_other_is_refused():
    robot = replace(rods(), reference=np.array([0.0, 1.0, 1.0]))
    with pytest.raises(InputError, match=r"'joint0' in q of terminal_state is -.* m from 'joint2'"):
        bodies_of(past(swing(end=np.array([0.0, 2.1, 2.1]), robot=robot), self_collision=True))


def test_final_posture_below_the_ground_is_refused():
    problem, sunk = standing(), high()
    sunk[2] -= 1.25
    final = TerminalState(q=sunk)
    with pytest.raises(InputError, match=r"in q of terminal_state is .* from 'ground'"):
        bodies_of(replace(in_the_air(problem), initial_q=high(), terms=(final,)))


def test_posture_of_a_landing_is_judged_by_its_links_alone():
    problem = standing()
    scene, postures = bodies_of(problem).scene, sampled_postures(problem.robot, 100)
    folded = postures[scene.distances(postures)[:, scene.n_outer :].min(axis=1).argmin()]
    sunk = problem.initial_q - np.eye(len(folded))[2]
    landed = TerminalPosture(q=sunk, over=problem.robot.contacts[0].name)
    assert bodies_of(replace(problem, terms=(landed,))).pairs
    with pytest.raises(InputError, match="in q of terminal_posture is -"):
        bodies_of(replace(problem, terms=(replace(landed, q=folded),)))


def test_position_of_a_link_in_an_obstacle_is_refused_however_it_turns():
    """The last joint lies in its own link, a capsule: as deep as that is thick."""
    (thickness,) = (s.radius for s in ROD_CAPSULES if s.name == "joint2")

    def at(gap: float) -> FramePose:
        return FramePose(frame="joint2", position=LYING.centre + (LYING.radius + gap) * np.eye(3)[2])

    least = MARGIN + thickness
    assert bodies_of(ending(at(least))).pairs
    with pytest.raises(InputError, match=r"at the goal of frame_pose of 'joint2' is at most .* from 'lying'"):
        bodies_of(ending(at(least - 2 * GAP_SLACK)))


def test_pose_of_a_link_in_an_obstacle_is_refused_by_its_whole_shape():
    turn = pin.utils.rotate("y", np.pi / 2)
    over = FramePose(frame="joint2", position=LYING.centre + np.array([-0.3, 0.0, 0.15]))
    assert bodies_of(ending(over)).pairs
    with pytest.raises(InputError, match=r"at the goal of frame_pose of 'joint2' is 0.00.* from 'lying'"):
        bodies_of(ending(replace(over, rotation=turn)))
    assert bodies_of(ending(replace(over, rotation=turn.T))).pairs


def test_waypoint_in_an_obstacle_is_refused():
    with pytest.raises(InputError, match="at the goal of frame_pose of 'joint2'"):
        bodies_of(ending(FramePose(frame="joint2", position=LYING.centre, at=start_of("swing"))))


def test_rotation_alone_and_frames_without_shapes_are_not_judged():
    shapes = tuple(shape for shape in ROD_CAPSULES if shape.name != "joint2")
    inside = FramePose(frame="joint2", position=LYING.centre)
    assert bodies_of(ending(inside, shapes=shapes)).pairs
    assert bodies_of(ending(FramePose(frame="joint2", rotation=np.eye(3)))).pairs


def test_position_in_smooth_ground_is_judged_with_its_rotation_only():
    problem = replace(in_the_air(standing()), terrain=HILLS, initial_q=high())
    foot = problem.robot.contacts[0].frame
    below = FramePose(frame=foot, position=np.array([0.0, 0.0, -0.5]))
    assert bodies_of(replace(problem, terms=(below,))).pairs
    with pytest.raises(InputError, match="from 'ground'"):
        bodies_of(replace(problem, terms=(replace(below, rotation=np.eye(3)),)))
    with pytest.raises(InputError, match=r"is at most .* from 'ground'"):
        bodies_of(replace(problem, terrain=FlatGround(), terms=(below,)))


def test_link_in_the_ground_at_the_start_is_refused():
    problem = standing()
    sunk = problem.initial_q.copy()
    sunk[2] -= 0.25
    with pytest.raises(InputError, match="from 'ground'"):
        bodies_of(replace(in_the_air(problem), initial_q=sunk))


def in_the_air(problem: Problem) -> Problem:
    """The problem without its contacts, which are refused first off the ground."""
    phases = tuple(replace(phase, contacts=()) for phase in problem.schedule.phases)
    return replace(problem, schedule=trajopt.Schedule(phases), terms=())


def test_free_start_is_not_judged():
    problem = trajopt.load("quadruped-trot", robot="solo12")
    assert problem.periodicity is not None
    sunk = replace(problem, terrain=replace(problem.terrain, height=5.0))
    assert bodies_of(sunk).pairs


LYING = SphereObstacle(name="lying", centre=[0.8, 0.0, 0.2], radius=0.1)
SAME = SphereObstacle(name="joint1", centre=[3.0, 0.0, 0.0], radius=0.1)
NOWHERE = LinkShape.sphere("c", "nose", np.zeros(3), 0.1)
test_bad_settings_are_refused_in_one_line = refused_calls(
    (lambda: Clearance(margin=-0.1), "margin"),
    (lambda: Clearance(margin=np.nan), "margin"),
    (lambda: Clearance(obstacles=(BALL, BALL)), "named ball"),
    (lambda: bodies_of(past(swing(), SAME)), "named joint1"),
    (lambda: bodies_of(past(swing(), replace(FAR, name=GROUND))), "named ground"),
    (lambda: bodies_of(past(swing(), shapes=[NOWHERE])), "nose"),
)


def test_planes_of_the_ground_are_those_of_its_near_faces():
    problem = in_the_air(standing())
    found = bodies_of(replace(problem, terrain=STAIRS, initial_q=high()))
    foot = next(pair for pair in found.pairs if pair[0] == "FL_FOOT")
    q = high()[None]
    (every,), (one,) = (found.planes(q, [(0, foot)], within, [None]) for within in (np.inf, 0.0))
    assert len(every) == len(STAIRS.faces) > 1
    assert len(one) == 1  # the nearest, however far
    assert all(plane.body is None for plane in every)


def high() -> np.ndarray:
    q = robots.load("solo12").reference.copy()
    q[2] += 1.0
    return q
