"""The solution file: exact round trips, and one clear line for everything that is wrong with a file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.support.refusals import assert_refused_in_one_line
from tests.support.replay_pages import hopping
from tests.support.synthetic_motions import arm_motion, sampled, standing, tumbling_flight, with_meta
from trajopt.errors import InputError, SolutionFileError
from trajopt.motion.configurations import geodesic_configurations
from trajopt.motion.consistency import OTHERS, REQUESTS, SAMPLED
from trajopt.motion.input import require_motion, solutions_of
from trajopt.motion.output import replacing_folder
from trajopt.motion.solution import Solution
from trajopt_library import robots

INTERVALS = 4


@pytest.fixture(scope="module")
def arm() -> Solution:
    robot = robots.load("ur5")
    return sampled(robot, [arm_motion(robot)], INTERVALS, visual=robot.visual.to_meta())


@pytest.fixture(scope="module")
def jump() -> Solution:
    robot = robots.load("solo12")
    return sampled(robot, [standing(robot), tumbling_flight(robot)], INTERVALS)


@pytest.fixture
def saved(arm: Solution, tmp_path: Path) -> Path:
    return arm.save(tmp_path / "arm.npz")


def rewritten(path: Path, **changes: object) -> Path:
    """The file with some arrays changed, or removed where the change is None."""
    with np.load(path) as archive:
        arrays = {**{name: archive[name] for name in archive.files}, **changes}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def rewrite_meta(path: Path, **changes: object) -> Path:
    with np.load(path) as archive:
        meta = {**json.loads(str(archive["meta"])), **changes}
    return rewritten(
        path, meta=np.array(json.dumps({key: value for key, value in meta.items() if value != "drop"}))
    )


@pytest.mark.parametrize("which", ["arm", "jump"])
def test_saved_solution_is_read_back_exactly(which, request, tmp_path):
    solution = request.getfixturevalue(which)
    loaded = Solution.load(solution.save(tmp_path / "motion.npz"))
    for name in (*SAMPLED, "interval_t"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(solution, name))
    assert loaded.meta == solution.meta
    assert loaded.model == robots.load(solution.description.robot).limited_model()
    assert loaded.converged
    assert loaded.n_intervals == solution.n_intervals


def test_impacts_are_read_back(jump, tmp_path):
    first_of_flight = jump.phases[1].start
    struck = replace(jump, impulse=np.ones((1, 4, 6)), impact_index=[first_of_flight])
    loaded = Solution.load(struck.save(tmp_path / "impact.npz"))
    np.testing.assert_array_equal(loaded.impulse, struck.impulse)
    np.testing.assert_array_equal(loaded.impact_index, struck.impact_index)


def with_requests(solution: Solution, **changes: np.ndarray | None) -> Solution:
    """The solution with what a controller asked for: no goals, the forces that act."""
    n, contacts = solution.active.shape
    goals = {"com_goal": np.full((n, 3), np.nan), "foot_goal": np.full((n, contacts, 3), np.nan)}
    return replace(solution, **{"asked_force": solution.f, **goals, **changes})


def test_what_a_controller_asked_for_is_read_back(jump, tmp_path):
    goal = np.full((jump.n_samples, 3), np.nan)
    goal[::2] = [0.1, 0.2, 0.3]
    asked = with_requests(jump, com_goal=goal)
    loaded = Solution.load(asked.save(tmp_path / "asked.npz"))
    for name in REQUESTS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(asked, name))
    assert Solution.load(jump.save(tmp_path / "none.npz")).asked_force is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"foot_goal": None}, "'asked_force', 'com_goal', 'foot_goal' must come together"),
        ({"com_goal": np.zeros((2, 3))}, r"'com_goal' has shape \(2, 3\), expected \(32, 3\)"),
        ({"com_goal": np.tile([0.0, np.nan, 0.0], (32, 1))}, "'com_goal' holds points that are NaN in part"),
        ({"com_goal": np.full((32, 3), np.inf)}, "'com_goal' holds NaN or infinity"),
        ({"asked_force": np.full((32, 4, 6), np.nan)}, "'asked_force' holds NaN or infinity"),
    ],
)
def test_what_no_controller_asks_for_is_refused(jump, tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        with_requests(jump, **changes).save(tmp_path / "asked.npz")


def test_infinite_limits_become_null(arm, tmp_path):
    unlimited = with_meta(arm, effort_limit=np.full(6, np.inf))
    assert Solution.load(unlimited.save(tmp_path / "arm.npz")).meta["effort_limit"] == [None] * 6


def test_phases_and_intervals_are_ranges_of_samples(jump):
    assert [len(phase) for phase in jump.phases] == [4 * INTERVALS] * 2
    assert jump.intervals[INTERVALS] == range(4 * INTERVALS, 4 * INTERVALS + 4)
    assert jump.contact_frames == ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    assert jump.contact_names == tuple(contact.name for contact in robots.load("solo12").contacts)
    assert with_meta(jump, drop=("contact_names",)).contact_names == jump.contact_frames
    assert jump.n_unactuated == 6


def test_interpolation_meets_the_samples_and_stays_on_the_manifold(jump):
    np.testing.assert_allclose(geodesic_configurations(jump, jump.t[5]), jump.q[5], atol=1e-12)
    times = np.linspace(-0.1, jump.t[-1] + 0.1, 101)
    q = geodesic_configurations(jump, times)
    assert q.shape == (101, 19)
    np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(q[-1], jump.q[-1], atol=1e-12)
    np.testing.assert_allclose(q[0], jump.q[0], atol=1e-12)


def test_at_a_phase_change_interpolation_takes_the_later_limit(jump):
    before, after = jump.phases[0][-1], jump.phases[1][0]
    assert jump.t[before] == pytest.approx(jump.t[after])
    np.testing.assert_allclose(geodesic_configurations(jump, jump.t[after]), jump.q[after], atol=1e-12)


def test_failed_write_leaves_nothing_behind(arm, tmp_path):
    with pytest.raises(InputError, match=r"cannot write .*No such file or directory"):
        arm.save(tmp_path / "none" / "arm.npz")
    with pytest.raises(InputError, match="it is a folder"):
        arm.save(tmp_path)
    old = tmp_path / "old.npz"
    old.write_text("kept")
    broken = replace(arm, q=np.full_like(arm.q, np.nan))
    with pytest.raises(InputError, match="'q' holds NaN or infinity"):
        broken.save(old)
    assert old.read_text() == "kept"
    assert [path.name for path in tmp_path.iterdir()] == ["old.npz"]


def test_place_that_takes_no_files_is_refused(arm):
    with pytest.raises(InputError, match="cannot write"):
        arm.save("/proc/arm.npz")


@pytest.mark.parametrize("fraction", [0.0, 0.01, 0.5, 0.99])
def test_truncated_file_is_refused_in_one_line(saved, fraction):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(SolutionFileError) as caught:
        Solution.load(saved)
    assert "\n" not in str(caught.value)


def test_damaged_bytes_are_refused(saved):
    content = bytearray(saved.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 64] = bytes(64)
    saved.write_bytes(bytes(content))
    with pytest.raises(SolutionFileError):
        Solution.load(saved)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: path.write_text("hello"), "not a trajopt-solution file"),
        (lambda path: np.save(path.open("wb"), np.zeros(3)), "not a trajopt-solution file"),
        (lambda path: np.savez(path, x=np.zeros(3)), "no text 'meta'"),
        (lambda path: np.savez(path, meta=np.array({"format": 1}, dtype=object)), "'meta' is of type object"),
        (lambda path: np.savez(path, meta=np.array("no json")), "not JSON"),
        (lambda path: np.savez(path, meta=np.array('{"format": "other"}')), "not a trajopt-solution file"),
        (lambda path: path.unlink(), "does not exist"),
    ],
)
def test_foreign_file_is_refused(saved, write, message):
    write(saved)
    with pytest.raises(SolutionFileError, match=message):
        Solution.load(saved)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "of version 2; version 1"),
        (
            {"friction": [0.5]},
            "friction of meta is not a list with an entry for each of the 0 contact_frames",
        ),
        (
            {
                "contact_frames": ["paw"],
                "contact_kinds": ["point"],
                "friction": [1.0],
                "contact_radius": [0.0],
                "contact_names": ["paw"],
            },
            r"'f' has shape",
        ),
        ({"contact_names": ["paw"]}, "contact_names .* an entry for each of the 0 contact_frames"),
        ({"effort_limit": [1.0]}, "effort_limit of meta has 1 entries, expected 6"),
        ({"velocity_limit": "fast"}, "velocity_limit of meta is not null"),
        ({"success": "yes"}, "success of meta"),
        ({"contact_sizes": [[0.1, 0.1]]}, "contact_sizes of meta"),
        ({"terrain": "drop"}, "meta lacks 'terrain'"),
        ({"parameters": 7}, "parameters of meta is not an object"),
        ({"versions": 1}, "versions of meta is 1; allowed: a mapping"),
        ({"tolerance": None}, "tolerance of meta is not"),
        ({"phase_names": [1]}, "phase_names of meta is not a list of texts"),
        ({"phase_names": ["one", "two"]}, "phase_names of meta is not a list of 1 texts"),
        ({"payloads": "box"}, "payloads of meta is not null or a list"),
        ({"payloads": [3]}, "payloads of meta: .* 3"),
        ({"payloads": [{"frame": "paw", "mass": 1.0}]}, "payloads of meta: .*paw"),
        ({"units": {"length": 1e9}}, "units of meta are .* those of its model: weight"),
        ({"units": [1.0]}, "units of meta are"),
    ],
)
def test_inconsistent_meta_is_refused(saved, changes, message):
    with pytest.raises(SolutionFileError, match=message):
        Solution.load(rewrite_meta(saved, **changes))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("tau", lambda x: None, "missing key 'tau'"),
        ("q", lambda x: x[:-1], r"'q' of the solution has shape \(15, 6\)"),
        ("q", lambda x: x[:, :-1], r"'q' has shape \(16, 5\), expected \(16, 6\)"),
        (
            "v",
            lambda x: np.where(np.arange(16)[:, None] == 3, np.nan, x),
            r"'v' holds NaN or infinity, first at \(3, 0\)",
        ),
        ("t", lambda x: x[::-1], "its samples do not start and end with its nodes"),
        ("interval_t", lambda x: x[::-1], "not increasing and without gaps"),
        ("interval_t", lambda x: x[:-1], "3 rows for 4 intervals"),
        ("interval", lambda x: x + 1, "'interval' does not count up from 0"),
        ("phase", lambda x: np.arange(16) // 5, "'phase' changes within it"),
        ("collocation", lambda x: np.zeros(16, bool), "no collocation points"),
        ("collocation", lambda x: x.astype(float), "'collocation' is of type float64; bool"),
        ("q", lambda x: x.astype(str), "'q' is of type <U32; float"),
        ("model", lambda x: np.zeros(3), "'model' is of type float64; text"),
        ("model", lambda x: np.array(["a", "b"]), "'model' is not a text"),
    ],
)
def test_inconsistent_arrays_are_refused(saved, name, change, message):
    with np.load(saved) as archive:
        array = archive[name]
    with pytest.raises(SolutionFileError, match=message):
        Solution.load(rewritten(saved, **{name: change(array)}))


def test_lonely_impulse_is_refused(saved):
    with pytest.raises(SolutionFileError, match="must come together"):
        Solution.load(rewritten(saved, impulse=np.zeros((0, 0, 6))))


def test_meta_that_is_no_json_is_not_written(arm, tmp_path):
    strange = with_meta(arm, parameters={"model": pin.Model()})
    with pytest.raises(InputError, match="cannot be written as JSON"):
        strange.save(tmp_path / "arm.npz")


def test_natural_units_are_stated_and_are_the_models(saved, arm):
    """A reader without Pinocchio has them; a file that states others would be judged by them."""
    with np.load(saved) as archive:
        units = json.loads(str(archive["meta"]))["units"]
    weight = 9.81 * sum(inertia.mass for inertia in list(arm.model.inertias)[1:])
    assert units["weight"] == pytest.approx(weight)
    assert units["time"] == pytest.approx(np.sqrt(units["length"] / units["gravity"]))
    with pytest.raises(SolutionFileError, match="units of meta"):
        Solution.load(rewrite_meta(saved, units={**units, "length": 2 * units["length"]}))
    assert Solution.load(rewrite_meta(saved, units="drop")).t[0] == 0.0


def test_every_array_of_the_format_is_a_field():
    assert {*SAMPLED, *OTHERS, "description", "statistics", "model"} == set(Solution.__dataclass_fields__)


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


MARKER = "meta/info.json"


def write(target: Path, text: str) -> None:
    with replacing_folder(target, MARKER) as unfinished:
        (unfinished / "meta").mkdir()
        (unfinished / MARKER).write_text(text)


def test_a_folder_is_made_and_replaced_by_a_later_one(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    for text in ("first", "second"):
        write(target, text)
        assert (target / MARKER).read_text() == text
        (target / "left over").touch()
        assert [path.name for path in tmp_path.iterdir()] == ["out"]
    write(target, "third")
    assert [path.name for path in target.iterdir()] == ["meta"]


def test_an_error_within_leaves_the_earlier_folder(tmp_path: Path) -> None:
    def fail() -> None:
        with replacing_folder(tmp_path / "out", MARKER) as unfinished:
            (unfinished / "half").touch()
            raise KeyError

    write(tmp_path / "out", "first")
    with pytest.raises(KeyError):
        fail()
    assert (tmp_path / "out" / MARKER).read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_other_folders_and_files_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "diary.txt").write_text("dear")
    (tmp_path / "file").write_text("text")
    for name, words in (
        ("other", "it is there and is no such export; allowed: another name"),
        ("file", "it is not a folder"),
        ("no/out", "does not exist"),
    ):
        assert_refused_in_one_line(lambda name=name: write(tmp_path / name, "new"), words)
    assert (tmp_path / "other" / "diary.txt").read_text() == "dear"
    assert (tmp_path / "file").read_text() == "text"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "other"]
