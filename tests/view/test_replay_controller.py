"""The layer of a whole-body controller in a replay: forces asked for, goals, and when it is shown."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support.replay_pages import STANCE, objects_of, scene_of, shown, tracks_of
from trajopt.motion.solution import Solution
from trajopt.view.replay.contacts import HEAD_LENGTH
from trajopt.view.replay.motion import replay_motion, replay_motions
from trajopt.view.replay.scene import build_scene
from trajopt.view.replay.show import replay

FOOT = "FL_FOOT"
SHIFT = np.array([0.02, -0.01, 0.005])  # m, of what is wanted from where it is
THINNED = 5e-4  # m: twice the stated error of a robot half a metre long, and rounding


@pytest.fixture(scope="module")
def asked(bones: Solution) -> Solution:
    """The hop, with twice its forces asked for, and goals beside the feet while they are in the air."""
    motion = replay_motion(bones)
    feet = np.tile(
        motion.feet[0] + bones.description.radii[:, None] * [0.0, 0.0, 1.0], (bones.n_samples, 1, 1)
    )
    goal = np.where(bones.active[:, :, None], np.nan, feet + SHIFT)
    com = np.where(bones.active.any(axis=1)[:, None], SHIFT, np.nan)
    return replace(bones, asked_force=2.0 * bones.f, com_goal=com, foot_goal=goal)


def layers(solution: Solution) -> dict[str, dict]:
    return {
        layer["name"]: layer for layer in build_scene([solution], replay_motions([solution])).facts["layers"]
    }


def test_the_layer_is_there_only_where_a_controller_asked(bones: Solution, asked: Solution) -> None:
    assert "controller" not in layers(bones)
    found = layers(asked)["controller"]
    assert found["visible"]
    assert found["paths"] == ["controller"]
    lines = build_scene([asked], replay_motions([asked])).facts["lines"]
    assert [line["layer"] for line in lines].count("controller") == 1


def test_forces_asked_for_have_the_scale_of_the_forces(asked: Solution, tmp_path) -> None:
    tracks = tracks_of(shown(asked, tmp_path))
    lengths = {}
    for place in (f"forces/{FOOT}", f"controller/forces/{FOOT}"):
        head = tracks[f"{place}/head", "position"][0, 2], tracks[f"{place}/head", "scale"][0, 0]
        lengths[place] = head
        assert_allclose(tracks[place, "position"][0], tracks[f"forces/{FOOT}", "position"][0])
    (neck, scale), (asked_neck, asked_scale) = lengths.values()
    size = build_scene([asked], replay_motions([asked])).facts["size"]
    tip = HEAD_LENGTH * size
    assert asked_neck + asked_scale * tip == pytest.approx(2 * (neck + scale * tip), rel=1e-2)
    colours = {
        path: content["materials"][0]["color"]
        for path, content in objects_of(shown(asked, tmp_path)).items()
        if "forces" in path
    }
    assert len(set(colours.values())) == 2


def test_goals_are_marked_while_there_are_any(asked: Solution, tmp_path) -> None:
    tracks, motion = tracks_of(shown(asked, tmp_path)), replay_motion(asked)
    flying = ~motion.active.any(axis=1)
    seen = tracks[f"controller/feet/{FOOT}", "visible"][:, 0].astype(bool)
    assert seen.any()
    assert not seen[motion.t < STANCE - 1e-9].any()
    assert (seen <= flying).all()
    place = tracks[f"controller/feet/{FOOT}", "position"][seen]
    assert_allclose(place, np.tile(motion.feet[0, 0] + SHIFT, (len(place), 1)), atol=THINNED)
    wanted = tracks["controller/com", "visible"][:, 0].astype(bool)
    assert (wanted <= ~flying).all()
    assert_allclose(tracks["controller/com", "position"][wanted][0], SHIFT, atol=THINNED)
    assert_allclose(tracks["controller/measured", "position"], tracks["com/ball", "position"], atol=THINNED)


def test_of_several_solutions_only_the_simulated_one_has_the_layer(bones: Solution, asked: Solution) -> None:
    scene = build_scene([bones, asked], replay_motions([bones, asked]))
    found = {layer["name"]: layer for layer in scene.facts["layers"]}
    assert found["controller"]["paths"] == ["run1/controller"]


def test_without_goals_and_forces_nothing_is_drawn(bones: Solution, tmp_path) -> None:
    n, contacts = bones.active.shape
    none = replace(
        bones,
        asked_force=np.zeros((n, contacts, 6)),
        com_goal=np.full((n, 3), np.nan),
        foot_goal=np.full((n, contacts, 3), np.nan),
    )
    replay(none, html=tmp_path / "none.html")
    drawn = objects_of(scene_of((tmp_path / "none.html").read_text()))
    assert not any(path.startswith("controller") for path in drawn)
