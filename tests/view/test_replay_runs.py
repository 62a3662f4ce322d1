"""Several solutions in one scene, poses at changes of phase, goals and carried bodies."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import STANCE, objects_of, placements_of, scene_of, shown, tracks_of
from tests.support.synthetic_motions import arm_motion, sampled, with_meta
from trajopt import InputError, Solution, replay, start_of
from trajopt.errors import SolutionFileError
from trajopt.motion.configurations import geodesic_configurations
from trajopt.schedule import Target
from trajopt.terms import FramePose, TerminalState
from trajopt.view.replay.motion import replay_motion, replay_motions
from trajopt.view.replay.robot import joint_path
from trajopt.view.replay.runs import GAP, MOST_GHOSTS, ghost_frames
from trajopt.view.replay.scene import ReplayScene, build_scene
from trajopt_library import robots

INTERVALS = 3
THINNED = 5e-4  # m: twice the stated error of a robot half a metre long, and rounding
SINGLE_PRECISION = 2e-6  # of lengths around one
GHOST_COST = 8e3  # bytes of a page for one more pose of a robot with 17 meshes


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot)], INTERVALS, visual=None)


def moving(solution: Solution, way: float) -> Solution:
    """The base travels ``way`` m along x, evenly over the phases."""
    q = solution.q.copy()
    q[:, 0] += way * solution.t / solution.t[-1]
    return replace(solution, q=q)


def scene(solutions: list[Solution], **options: object) -> ReplayScene:
    return build_scene(solutions, replay_motions(solutions), **options)


def page_of(solutions: list[Solution], tmp_path, **options: object) -> dict:
    replay(solutions, html=tmp_path / "page.html", **options)
    return scene_of((tmp_path / "page.html").read_text())


# Several solutions


def test_each_solution_is_drawn_below_its_own_root_and_moves_as_alone(bones, arm, tmp_path):
    both = tracks_of(page_of([bones, arm], tmp_path))
    for number, solution in enumerate((bones, arm)):
        motion = replay_motions([bones, arm])[number]
        for joint in range(1, solution.model.njoints):
            got = both[f"run{number}/{joint_path(solution.model, joint)}", "position"]
            assert_allclose(got, motion.joints[:, joint, :3, 3], atol=2 * THINNED)


def test_clock_is_shared_and_what_has_ended_stays(bones):
    late = replace(bones, t=bones.t + 0.2, interval_t=bones.interval_t + 0.2)
    first, second = replay_motions([moving(bones, 1.0), moving(late, 1.0)])
    assert first.t[0] == bones.t[0]
    assert first.t[-1] == pytest.approx(late.t[-1])
    np.testing.assert_array_equal(first.t, second.t)
    ended, waiting = first.t > bones.t[-1] + 1e-9, second.t < late.t[0] - 1e-9
    assert ended.any()
    assert waiting.any()
    assert_allclose(first.q[ended], np.tile(moving(bones, 1.0).q[-1], (ended.sum(), 1)))
    assert_allclose(second.q[waiting], np.tile(moving(late, 1.0).q[0], (waiting.sum(), 1)))


@pytest.mark.long
def test_second_robot_is_tinted_and_shares_the_meshes(hop, tmp_path):
    alone, both = page_of([hop], tmp_path), page_of([hop, hop], tmp_path)
    meshes = [mesh for mesh in both["meshes"] if hasattr(mesh, "data")]
    assert len(meshes) == len([mesh for mesh in alone["meshes"] if hasattr(mesh, "data")])
    run = scene([hop, hop]).facts["runs"][1]
    drawn = {path: o for path, o in objects_of(both).items() if path.startswith("run1/robot/")}
    assert len(drawn) == 17
    for content in drawn.values():
        assert f"#{content['materials'][0]['color']:06x}" == run["colour"]
        assert 0 < content["materials"][0]["opacity"] < 1
    assert not any(
        o.get("materials", [{}])[0].get("opacity", 1.0) < 1
        for path, o in objects_of(both).items()
        if path.startswith("run0/robot/")
    )


def test_side_by_side_robots_are_apart_across_their_way_and_in_their_own_colours(bones, tmp_path):
    given = [moving(bones, 1.0), moving(bones, 1.0)]
    page, facts = page_of(given, tmp_path, layout="side-by-side"), scene(given, layout="side-by-side").facts
    shift = placements_of(page)["run1"][:3, 3]
    width = facts["box"][1][1] - facts["box"][0][1]
    assert shift[0] == shift[2] == 0
    assert width == pytest.approx(2 * shift[1] - GAP * facts["size"], rel=1e-3)  # two widths and the gap
    colours = [
        {
            path[5:]: o["materials"][0]["color"]
            for path, o in objects_of(page).items()
            if path.startswith(root)
        }
        for root in ("run0/robot/", "run1/robot/")
    ]
    assert colours[0] == colours[1]


def test_robots_that_differ_are_side_by_side_unless_told(bones):
    other = with_meta(bones, robot="another")

    overlaid = scene([bones, bones], layout="overlaid").facts["box"]

    def laid_over(solutions, **layout):
        return bool(np.allclose(scene(solutions, **layout).facts["box"], overlaid))

    assert laid_over([bones, bones])
    assert laid_over([bones, other], layout="overlaid")
    assert not laid_over([bones, other])


def test_robots_on_one_plane_stand_on_one_ground(bones):
    paths = [
        c.message["path"]
        for c in scene([bones, bones], layout="side-by-side").commands
        if c.message["type"] == "set_object"
    ]
    assert sum(path.endswith("ground/plane") for path in paths) == 1


def test_labels_name_the_runs_and_have_to_be_as_many(bones):
    facts = scene([bones, bones], labels=["coarse", "fine"]).facts
    assert [run["label"] for run in facts["runs"]] == ["coarse", "fine"]
    assert [layer["label"] for layer in facts["layers"][-2:]] == ["coarse", "fine"]
    assert len({run["label"] for run in scene([bones, bones]).facts["runs"]}) == 2
    with pytest.raises(InputError, match="1 labels for 2"):
        scene([bones, bones], labels=["coarse"])


def test_unknown_layout_and_nothing_to_show_are_refused(bones):
    with pytest.raises(InputError, match="stacked"):
        scene([bones], layout="stacked")
    with pytest.raises(InputError, match="nothing"):
        replay_motions([])


def test_facts_tell_phases_layers_and_where_the_base_is(bones):
    facts = scene([with_meta(bones, phase_names=["stance", "flight", "landing"])]).facts
    assert [phase["name"] for phase in facts["phases"]] == ["stance", "flight", "landing"]
    assert facts["phases"][1]["start"] == pytest.approx(STANCE)
    assert facts["runs"][0]["base"] == "robot/root_joint"
    drawn = {
        c.message["path"].removeprefix("/meshcat/")
        for c in scene([bones]).commands
        if c.message["type"] == "set_object"
    }
    for layer in facts["layers"]:
        assert re.fullmatch("#[0-9a-f]{6}", layer["colour"])
        for path in layer["paths"]:
            assert any(place.startswith(f"{path}/") for place in drawn)
    shown_first = {layer["name"]: layer["visible"] for layer in facts["layers"]}
    assert shown_first["robot"]
    assert not shown_first["ghosts"]


@pytest.mark.parametrize(("way", "travels"), [(0.0, False), (1.0, False), (5.0, True)])
def test_facts_say_whether_a_camera_should_follow(bones, way, travels):
    assert scene([moving(bones, way)]).facts["travels"] is travels


# Poses at changes of phase


def test_ghosts_stand_as_the_robot_does_where_phases_change(bones, tmp_path):
    far = moving(bones, 2.0)
    page, motion = shown(far, tmp_path), replay_motion(far)
    frames = ghost_frames(motion, 0.4)
    changes = [0, *(np.flatnonzero(np.diff(motion.phase)) + 1), motion.n_frames - 1]
    assert frames == changes
    data, places = far.model.createData(), placements_of(page)
    for number, frame in enumerate(frames):
        pin.forwardKinematics(far.model, data, geodesic_configurations(far, motion.t[frame]))
        for joint in range(1, far.model.njoints):
            path = joint_path(far.model, joint).replace("robot/", f"ghosts/pose{number}/")
            assert_allclose(places[path], data.oMi[joint].homogeneous, atol=SINGLE_PRECISION)


def test_ghosts_are_few_spread_and_different(bones):
    far = moving(bones, 10.0)
    phase = np.repeat(np.arange(far.n_intervals), [len(rows) for rows in far.intervals])
    motion = replay_motion(replace(far, phase=phase))
    frames = ghost_frames(motion, 0.4)
    assert len(frames) == MOST_GHOSTS
    assert {0, motion.n_frames - 1} <= set(frames)
    assert ghost_frames(replay_motion(bones), 0.4) == [0]  # it ends as it began


@pytest.mark.long
def test_one_more_ghost_costs_the_page_little(hop, tmp_path):
    sizes = []
    for way in (0.0, 3.0):
        sizes.append(replay(moving(hop, way), html=tmp_path / "page.html").size)
    more = len(ghost_frames(replay_motion(moving(hop, 3.0)), 0.5)) - 1
    assert more >= 2
    assert sizes[1] - sizes[0] < more * GHOST_COST + 40e3  # and the tracks of a base that moves


# Goals


def test_goals_of_a_problem_are_what_its_terms_ask_for():
    position, rotation = np.array([0.1, 0.2, 0.3]), pin.utils.rotate("x", 0.4)
    pose = FramePose(frame="tool", position=position, rotation=rotation, at=start_of("lift")).targets()[0]
    assert (pose.frame, pose.at) == ("tool", start_of("lift"))
    assert_allclose(pose.position, position)
    assert_allclose(pose.rotation, rotation)
    again = Target.from_description(pose.describe())
    assert_allclose(again.rotation, rotation)
    state = TerminalState(q=np.arange(4.0)).targets()[0]
    assert state.frame is None
    assert_allclose(state.q, np.arange(4.0))


def test_goals_are_marked_where_they_are(bones, arm, tmp_path):
    place, turn = np.array([0.3, 0.1, 0.2]), pin.utils.rotate("z", 0.7)
    goals = [
        Target(frame="base_link", position=place, rotation=turn),
        Target(frame="base_link", position=place + 0.1),
        Target(frame="FL_FOOT", position=np.array([0.5, 0.0, 0.0]), at=start_of("landing")),
        Target(q=bones.q[0]),
    ]
    told = with_meta(
        bones,
        goals=[goal.describe() for goal in goals],
        phase_names=["stance", "flight", "landing"],
    )
    places = placements_of(shown(told, tmp_path))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    assert_allclose(places["goals/pose0"], pose, atol=SINGLE_PRECISION)
    assert_allclose(places["goals/place1"][:3, 3], place + 0.1, atol=SINGLE_PRECISION)
    assert_allclose(places["goals/foothold2"][:2, 3], [0.5, 0.0], atol=SINGLE_PRECISION)
    data = bones.model.createData()
    pin.forwardKinematics(bones.model, data, bones.q[0])
    assert_allclose(places["goals/pose3"], data.oMi[1].homogeneous, atol=SINGLE_PRECISION)


def test_solution_without_goals_draws_none_and_damaged_ones_are_refused(bones, tmp_path):
    assert not any(path.startswith("goals") for path in objects_of(shown(bones, tmp_path)))
    for damaged in ("x", [{"frame": "base_link"}], [Target(q=np.zeros(3)).describe() | {"q": [["a"]]}]):
        with pytest.raises(SolutionFileError, match="goals"):
            scene([with_meta(bones, goals=damaged)])


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"frame": "a"},
        {"position": np.zeros(3)},
        {"frame": "a", "position": np.zeros(2)},
        {"frame": "a", "position": np.full(3, np.nan)},
        {"q": np.array(1.0)},
    ],
)
def test_target_that_says_nothing_or_no_numbers_is_refused(wrong):
    with pytest.raises(InputError):
        Target(**wrong)


# Carried bodies


def test_carried_body_waits_is_carried_and_stays(bones, tmp_path):
    far = moving(bones, 1.0)
    entry = {"frame": "FL_FOOT", "mass": 0.3, "centre": [0.0, 0.0, 0.1], "inertia": np.zeros((3, 3)).tolist()}
    page = shown(with_meta(far, payloads=[{**entry, "phases": [1]}]), tmp_path)
    track, motion = tracks_of(page)["payloads/body0", "position"], replay_motion(far)
    carried = np.flatnonzero(motion.phase == 1)
    foot = motion.feet[:, 0]
    assert_allclose(track[carried], foot[carried], atol=THINNED)
    assert_allclose(track[: carried[0]], np.tile(foot[carried[0]], (carried[0], 1)), atol=THINNED)
    assert_allclose(
        track[carried[-1] :], np.tile(foot[carried[-1]], (motion.n_frames - carried[-1], 1)), atol=THINNED
    )
    ball = objects_of(page)["payloads/body0/shape"]["geometries"][0]
    assert 4 / 3 * np.pi * ball["radius"] ** 3 * 800 == pytest.approx(0.3, rel=1e-4)


def test_body_that_is_carried_in_two_phases_is_one(bones, tmp_path):
    entry = {
        "frame": "FL_FOOT",
        "mass": 0.3,
        "centre": [0.0, 0.0, 0.0],
        "inertia": (1e-3 * np.eye(3)).tolist(),
    }
    told = with_meta(bones, payloads=[{**entry, "phases": [0]}, {**entry, "phases": [1]}])
    bodies = [path for path in objects_of(shown(told, tmp_path)) if path.startswith("payloads/")]
    assert bodies == ["payloads/body0/shape"]
