"""Iterates while a problem is solved: their motion, their picture, and that nothing is disturbed."""

import asyncio
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from numpy.testing import assert_allclose, assert_array_equal
from tornado.websocket import websocket_connect

from tests.support.problems import hop, hopper, lean, reach
from tests.support.processes import LIMIT, TRAJOPT, AtTerminal, run
from tests.support.replay_pages import objects_of, placements_of, tracks_of
from trajopt import Problem, solve
from trajopt.robot.building import reach as reach_of
from trajopt.solvers.drivers import SOLVERS
from trajopt.solving.monitoring import Iterate
from trajopt.view.replay.commands import ANGLE_ERROR, POSITION_ERROR
from trajopt.view.watching.drawing import (
    HEAVY,
    LEAST_POSES,
    MOST_POSES,
    PATHS,
    POSES,
    IterateMotion,
    IterateScene,
    Picture,
)
from trajopt.view.watching.viewer import Viewer
from trajopt_library import problems

pytestmark = pytest.mark.long

# Two ways to one configuration: rounding.
ROUNDING = 1e-12
# Meshcat's numbers have single precision, and key frames are thinned within these parts of the reach.
PICTURE = 2 * max(POSITION_ERROR, ANGLE_ERROR)


def kept(problem: Problem, **settings: Any) -> list[Iterate]:
    """Every iterate of a solve, its unknowns read in time."""
    found: list[Iterate] = []

    def keep(iterate: Iterate) -> None:
        assert iterate.unknowns is not None
        found.append(iterate)

    settings = {"transcription": "legendre:2", **settings}
    solve(problem, watch=keep, **settings, fixed_mesh=True)
    return found


@lru_cache
def hop_iterates() -> tuple[Iterate, ...]:
    return tuple(kept(hop(), intervals=12))


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "floating base, impacts": lambda: problems.load("hopper-hop", touchdown="impact"),
    "minimal coordinates": lambda: problems.load("hopper-hop", coordinates="minimal"),
    "velocity source": lambda: problems.load("irb1600-transfer"),
    "free durations, periodic": lambda: problems.load("hopper-gait", durations="free"),
    "fixed base": reach,
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_configurations_at_nodes_are_those_of_the_solution(name: str):
    for iterate in kept(PROBLEMS[name](), max_iterations=3, transcription=None):
        t, q, phase = iterate.configurations()
        solution = iterate.solution()
        nodes = [rows.start for rows in solution.intervals] + [solution.intervals[-1].stop - 1]
        assert_allclose(t, solution.t[nodes], atol=ROUNDING)
        assert_allclose(q, solution.q[nodes], atol=ROUNDING)
        assert_array_equal(phase, solution.phase[nodes])


@pytest.mark.parametrize("solver", SOLVERS)
def test_watching_changes_neither_iterations_nor_result(solver: str):
    settings: dict[str, Any] = {"solver": solver, "transcription": "legendre:2"}
    alone = solve(lean(), **settings, fixed_mesh=True)
    with Viewer() as viewer:
        watched = solve(lean(), watch=viewer, **settings, fixed_mesh=True)
        assert viewer.flush(LIMIT)
        assert viewer.drawn >= 2
    assert watched.statistics.iterations == alone.statistics.iterations
    for name in ("t", "q", "v", "tau", "f"):
        assert_array_equal(getattr(watched, name), getattr(alone, name))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_watch_sees_guess_every_iteration_and_the_end(solver: str):
    told: list[int] = []

    def tell(figures: dict[str, float]) -> bool:
        told.append(int(figures["iteration"]))
        return True

    found = kept(lean(), solver=solver, progress=tell, label="one of one")
    assert [iterate.stage for iterate in found] == ["guess", *["iteration"] * len(told), "end"]
    assert [iterate.figures["iteration"] for iterate in found[1:-1]] == told
    assert {iterate.label for iterate in found} == {"one of one"}
    assert found[-1].status == "solved"
    assert found[-1].figures["objective"] == pytest.approx(found[-2].figures["objective"])


def test_the_end_is_the_solution_and_the_guess_the_start():
    found: list[Iterate] = []
    solution = solve(hop(), watch=found.append, intervals=12)
    assert_array_equal(found[-1].solution().q, solution.q)
    again = solve(hop(), max_iterations=0, intervals=12, watch=found.append)
    assert again.statistics.iterations == 0
    assert_allclose(found[0].solution().t, again.t, atol=ROUNDING)


def test_unknowns_that_were_not_read_in_time_are_refused():
    found: list[Iterate] = []
    solve(hop(), watch=found.append, max_iterations=2, fixed_mesh=True)
    with pytest.raises(RuntimeError, match="during its callback only"):
        _ = found[1].unknowns


def test_an_iterate_of_a_restoration_phase_has_a_motion():
    found = kept(hop(), perturb=3.0, seed=1, max_iterations=60)
    restoring = [iterate for iterate in found if iterate.figures.get("restoration")]
    assert restoring
    for iterate in restoring:
        t, q, _ = iterate.configurations()
        assert len(t) == iterate.transcription.layout.n_intervals + 1
        assert np.isfinite(q).all()


def picture_of(iterate: Iterate) -> Picture:
    found = IterateScene().picture(iterate)
    assert found is not None
    return found


def scene(picture: Picture) -> dict[str, Any]:
    return {"commands": [command.message for command in picture.commands]}


def test_the_picture_of_an_iterate_is_its_forward_kinematics():
    iterate = hop_iterates()[5]
    solution, picture = iterate.solution(), picture_of(iterate)
    tracks, model = tracks_of(scene(picture)), solution.model
    frames = len(tracks["robot/shank", "position"])
    data, error = model.createData(), PICTURE * reach_of(model)
    for frame, t in enumerate(np.linspace(solution.t[0], solution.t[-1], frames)):
        pin.framesForwardKinematics(model, data, between_nodes(iterate, t))
        for joint in range(1, model.njoints):
            place = f"robot/{model.names[joint]}"
            shown = tracks[place, "position"][frame]
            assert_allclose(shown, data.oMi[joint].translation, atol=error)
            turned = pin.Quaternion(*np.roll(tracks[place, "quaternion"][frame], 1)).toRotationMatrix()
            assert_allclose(turned, data.oMi[joint].rotation, atol=PICTURE)


def between_nodes(iterate: Iterate, t: float) -> np.ndarray:
    """The geodesic between the nodes around ``t``, from all samples of the solution's own file."""
    solution = iterate.solution()
    rows = next(rows for rows in solution.intervals if t <= solution.t[rows.stop - 1] + ROUNDING)
    first, last = rows.start, rows.stop - 1
    part = (t - solution.t[first]) / (solution.t[last] - solution.t[first])
    return np.asarray(pin.interpolate(solution.model, solution.q[first], solution.q[last], part))


def test_poses_stand_at_the_changes_of_phase():
    iterate = hop_iterates()[-1]
    solution = iterate.solution()
    places = placements_of(scene(picture_of(iterate)))
    model, data = solution.model, solution.model.createData()
    rows = [phase.start for phase in solution.phases] + [len(solution.t) - 1]
    assert LEAST_POSES <= len(rows) <= MOST_POSES
    for number, row in enumerate(rows):
        pin.forwardKinematics(model, data, solution.q[row])
        for joint in range(1, model.njoints):
            shown = places[f"{POSES}/{number}/robot/{model.names[joint]}"]
            assert_allclose(shown, data.oMi[joint].homogeneous, atol=ROUNDING)


def test_paths_are_those_of_feet_and_centre_of_mass():
    iterate = hop_iterates()[-1]
    solution = iterate.solution()
    objects = objects_of(scene(picture_of(iterate)))
    foot, mass = (line_of(objects[f"{PATHS}/{name}"]) for name in ("foot", "centre of mass"))
    model, data = solution.model, solution.model.createData()
    for row, frame in ((0, 0), (-1, -1)):
        pin.centerOfMass(model, data, solution.q[row])
        pin.updateFramePlacements(model, data)
        frame_id = model.getFrameId(solution.contact_frames[0])
        assert_allclose(foot[frame], data.oMf[frame_id].translation, atol=1e-6)
        assert_allclose(mass[frame], data.com[0], atol=1e-6)


def line_of(drawn: dict[str, Any]) -> np.ndarray:
    array = drawn["geometries"][0]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(array.data, np.float32).reshape(-1, 3)


def test_the_scene_is_told_once_and_every_iterate_after_it_only_moves():
    drawing = IterateScene()
    pictures = [drawing.picture(iterate) for iterate in hop_iterates()]
    assert [picture is not None and picture.new for picture in pictures] == [True] + [False] * (
        len(pictures) - 1
    )
    for picture in pictures[1:]:
        assert picture is not None
        assert set(objects_of(scene(picture))) == {f"{PATHS}/foot", f"{PATHS}/centre of mass"}


def test_another_problem_has_a_new_scene():
    drawing = IterateScene()
    first, other = hop_iterates()[0], kept(reach(), max_iterations=0)[0]
    news = [drawing.picture(iterate) for iterate in (first, first, other)]
    assert [picture is not None and picture.new for picture in news] == [True, False, True]


def test_the_page_is_told_solve_iteration_figures_and_phases():
    guess, first, *_, end = hop_iterates()
    drawing = IterateScene()
    facts = [drawing.picture(iterate).facts for iterate in (guess, first, end)]  # type: ignore[union-attr]
    texts = [" | ".join(line["text"] for line in fact["lines"]) for fact in facts]
    assert texts[0] == "legendre:2, 12 intervals, ipopt | the guess"
    assert "iteration 0: solving" in texts[1]
    assert f"infeasibility {first.figures['primal']:.1e}" in texts[1]
    assert f"iteration {end.figures['iteration']}: solved" in texts[2]
    phases = facts[2]["phases"]
    assert [phase["name"] for phase in phases] == ["stance", "flight", "landing"]
    solution = end.solution()
    assert_allclose(
        [phase["start"] for phase in phases], [solution.t[rows.start] for rows in solution.phases]
    )
    assert {layer["name"] for layer in facts[2]["layers"]} >= {"robot", POSES, PATHS}


def spoilt(iterate: Iterate, nodes: range) -> Iterate:
    assert iterate.unknowns is not None
    x, layout = iterate.unknowns.copy(), iterate.transcription.layout
    for node in nodes:
        x[layout.node(node)] = np.nan
    return replace(iterate, read=lambda: x)


def test_nodes_that_are_not_finite_are_left_out():
    iterate = hop_iterates()[3]
    broken = spoilt(iterate, range(4, 6))
    t, q, _ = broken.configurations()
    assert len(t) == iterate.transcription.layout.n_intervals + 1 - 2
    assert np.isfinite(q).all()
    assert picture_of(broken).commands


def test_an_iterate_without_a_finite_node_changes_the_caption_alone():
    drawing, iterate = IterateScene(), hop_iterates()[3]
    lost = spoilt(iterate, range(iterate.transcription.layout.n_stages + 1))
    assert drawing.picture(lost) is None
    drawing.picture(iterate)
    picture = drawing.picture(lost)
    assert picture is not None
    assert picture.commands == []
    assert "no node of this iterate is finite" in [line["text"] for line in picture.facts["lines"]]


def test_a_rotation_that_is_not_normalised_is_drawn_normalised():
    iterate = hop_iterates()[3]
    assert iterate.unknowns is not None
    x, layout = iterate.unknowns.copy(), iterate.transcription.layout
    for node in range(layout.n_stages + 1):
        x[layout.node(node)][layout.forms[node].rotations] *= 3.0
    _, q, _ = replace(iterate, read=lambda: x).configurations()
    assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1.0, atol=ROUNDING)


def test_a_motion_of_one_node_is_a_pose():
    robot = hopper()
    q = pin.neutral(robot.model)
    motion = IterateMotion(
        model=robot.model,
        t=np.zeros(1),
        q=q[None],
        phase=np.zeros(1, dtype=int),
        frames=[robot.model.nframes - 1],
    )
    assert np.isfinite(motion.joints).all()
    assert len(motion.poses()) >= 1


def test_a_real_server_has_the_iterate_and_gives_it_to_a_browser_that_comes_later():
    with Viewer() as viewer:
        end = hop_iterates()[-1]
        for iterate in (hop_iterates()[0], end):
            viewer(iterate)
            assert viewer.flush(LIMIT)
        messages = asyncio.run(heard(viewer.url.replace("http", "ws")))
    solution = end.solution()
    model, data = solution.model, solution.model.createData()
    pin.forwardKinematics(model, data, solution.q[-1])
    tracks = tracks_of({"commands": messages})
    shown = tracks["robot/shank", "position"][-1]
    knee = data.oMi[model.getJointId("shank")].translation
    assert_allclose(shown, knee, atol=PICTURE * reach_of(model))
    facts = [message["value"] for message in messages if message.get("path") == "facts"]
    assert any("solved" in line["text"] for line in facts[-1]["lines"])


async def heard(url: str) -> list[dict[str, Any]]:
    """What a server tells a new browser, up to the end of the scene."""
    connection, found = await websocket_connect(url, connect_timeout=LIMIT, max_message_size=2**30), []
    while not found or found[-1].get("path") != "drawn":
        data = await asyncio.wait_for(connection.read_message(), LIMIT)
        assert isinstance(data, bytes)
        found.append(umsgpack.unpackb(data))
    connection.close()
    return found


def test_a_viewer_whose_server_dies_is_one_warning_and_the_solve_goes_on():
    viewer = Viewer()

    def watch(iterate: Iterate) -> None:
        if iterate.stage == "iteration" and iterate.figures["iteration"] == 1:
            viewer._window.server_proc.kill()
        viewer(iterate)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = solve(hop(), watch=watch, fixed_mesh=True)
        viewer.flush(LIMIT)
        viewer.close()
    assert found.converged
    (text,) = [str(warning.message) for warning in caught if "viewer" in str(warning.message)]
    assert text.startswith("the viewer has stopped, solving goes on")


def test_heavy_meshes_have_poses_of_bones(monkeypatch: pytest.MonkeyPatch):
    assert HEAVY > 1e6
    iterate = hop_iterates()[0]
    full = objects_of(scene(picture_of(iterate)))
    monkeypatch.setattr("trajopt.view.watching.drawing.HEAVY", 0)
    light = objects_of(scene(picture_of(iterate)))
    assert {name for name in light if name.startswith(POSES)}
    assert {name for name in full if not name.startswith(POSES)} == {
        name for name in light if not name.startswith(POSES)
    }


SMALL = ("hopper-hop", "--intervals", "12")


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", SMALL[0], "--ladder", "legendre:1@8,legendre:2@12"),
        ("continue", *SMALL, "--vary", "distance=0.1:0.2:2"),
    ],
    ids=["ladder", "continue"],
)
def test_a_script_that_watches_ends(arguments: tuple[str, ...], tmp_path: Path):
    done = run(*TRAJOPT, *arguments, "--watch", cwd=tmp_path)
    assert done.returncode == 1, done.stderr  # the mesh is coarse
    assert "http://" in done.stderr
    assert "warning" not in done.stderr


def test_at_a_terminal_the_solution_is_shown_until_ctrl_c(tmp_path: Path):
    command = ("solve", *SMALL, "--watch", "--output", tmp_path / "x.npz")
    with AtTerminal(*TRAJOPT, *command) as process:
        process.read_until("Ctrl-C stops the server")
        process.press()
        status, _, seen = process.finish()
    assert "solved" in seen
    assert status == 1  # the mesh is coarse
