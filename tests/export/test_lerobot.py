"""LeRobot's data sets, read as its LeRobotDataset does: schema by info.json, episodes by their metadata."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import trajopt
from tests.support.exported_plans import SINGLE, place_of, plan_to_export, rotation_of
from tests.support.refusals import assert_refused_in_one_line
from trajopt.export.writing import export_motion
from trajopt.motion.solution import Solution

pytestmark = pytest.mark.long

RATE = 40
# LeRobot refuses timestamps further than this, s, from multiples of a frame.
TOLERANCE_S = 1e-4
# Columns of every data set beside its own features, with their types.
DEFAULT = {"timestamp": "float32"} | dict.fromkeys(
    ("frame_index", "episode_index", "index", "task_index"), "int64"
)
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}


class LoadedDataset:
    """What the loader makes of a folder: it finds every file by the patterns in info.json."""

    def __init__(self, root: Path) -> None:
        self.info = json.loads((root / "meta/info.json").read_text())
        self.features: dict[str, Any] = self.info["features"]
        self.tasks = pd.read_parquet(root / "meta/tasks.parquet")
        self.stats = json.loads((root / "meta/stats.json").read_text())
        self.episodes = pq.read_table(sorted((root / "meta/episodes").glob("*/*.parquet"))).to_pylist()
        places = [(one["data/chunk_index"], one["data/file_index"]) for one in self.episodes]
        files = {
            root / self.info["data_path"].format(chunk_index=chunk, file_index=file) for chunk, file in places
        }
        assert files == set((root / "data").glob("*/*.parquet"))
        self.table = pq.read_table(sorted(files)).cast(self.schema())

    def schema(self) -> pa.Schema:
        """Types of the columns: a shape of one entry is a number, a longer one a list of fixed size."""
        fields = []
        for key, feature in self.features.items():
            (size,), kind = feature["shape"], pa.type_for_alias(feature["dtype"])
            fields.append(pa.field(key, kind if size == 1 else pa.list_(kind, size)))
        return pa.schema(fields)

    def column(self, key: str) -> np.ndarray:
        """Values (n, k) of a feature."""
        return np.array(self.table[key].to_pylist()).reshape(self.table.num_rows, -1)

    def entry(self, key: str, name: str) -> np.ndarray:
        """Values (n,) of one entry of a feature, by its name."""
        return self.column(key)[:, self.features[key]["names"].index(name)]


def loaded(plans: Solution | list[Solution], path: Path, **settings: Any) -> LoadedDataset:
    return LoadedDataset(export_motion(plans, "lerobot", path / "set", RATE, **settings))


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk", "planar hops", "an arm"])
def test_files_are_those_that_info_describes(kind: str, tmp_path: Path) -> None:
    read = loaded(plan_to_export(kind), tmp_path)
    info, count = read.info, read.table.num_rows
    assert (info["codebase_version"], info["fps"], info["video_path"]) == ("v3.0", RATE, None)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (1, count, 1)
    assert info["splits"] == {"train": "0:1"}
    assert set(read.table.column_names) == set(read.features) == set(read.stats)
    for key, feature in read.features.items():
        assert "/" not in key
        assert feature["dtype"] == DEFAULT.get(key, "float32")
        if key not in DEFAULT:
            assert len(set(feature["names"])) == feature["shape"][0]
        assert set(read.stats[key]) == STATISTICS
        columns = read.column(key)
        assert_allclose(read.stats[key]["mean"], columns.mean(axis=0), rtol=SINGLE, atol=SINGLE)
        assert_array_equal(read.stats[key]["max"], columns.max(axis=0))
        assert read.stats[key]["count"] == [count]
    steps = read.column("timestamp")[:, 0] * RATE
    assert_allclose(steps, read.column("frame_index")[:, 0], atol=TOLERANCE_S * RATE)


@pytest.mark.parametrize("kind", ["turning trot", "mirrored walk", "an arm"])
def test_frames_are_the_plan_by_name(kind: str, tmp_path: Path) -> None:
    plan = plan_to_export(kind)
    read = loaded(plan, tmp_path)
    for row in range(0, int(plan.t[-1] * RATE), 3):
        own = plan.sample(times=[row / RATE])
        close = {"rtol": SINGLE, "atol": SINGLE}
        for name in own.torque_names:
            position, rate = own.position_names.index(name), own.velocity_names.index(name)
            assert_allclose(read.entry("observation.state", f"{name}.pos")[row], own.q[0, position], **close)
            assert_allclose(read.entry("observation.state", f"{name}.vel")[row], own.v[0, rate], **close)
            torque = own.drive_torque[0, own.torque_names.index(name)]
            assert_allclose(read.entry("action", f"{name}.torque")[row], torque, **close)
        for number, frame in enumerate(own.contact_frames):
            assert read.entry("observation.contacts", frame)[row] == own.active[0, number]
            force = [read.entry("observation.contact_forces", f"{frame}.{axis}")[row] for axis in "xyz"]
            assert_allclose(force, own.force[0, number], **close)
            if own.contact_kinds[number] == "surface":
                key = "observation.contact_moments"
                moment = [read.entry(key, f"{frame}.{axis}")[row] for axis in "xyz"]
                assert_allclose(moment, own.moment[0, number], **close)


def test_the_base_is_where_pinocchio_has_it(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    read, row = loaded(plan, tmp_path), 7
    own = plan.sample(times=[row / RATE])
    place = place_of(plan.model, "base_link", own.q[0], own.v[0])
    pose, velocity = (read.column(f"observation.base_{name}")[row] for name in ("pose", "velocity"))
    assert_allclose(pose[:3], place.pose.translation, atol=SINGLE)
    assert_allclose(rotation_of(pose[[6, 3, 4, 5]]), place.pose.rotation, atol=SINGLE)
    assert_allclose(velocity, [*place.linear, *place.angular], atol=5 * SINGLE)


def test_features_without_entries_are_left_out(tmp_path: Path) -> None:
    features = loaded(plan_to_export("an arm"), tmp_path).features
    assert set(features) == {"observation.state", "action", *DEFAULT}


def test_several_motions_are_episodes(tmp_path: Path) -> None:
    plan = plan_to_export("turning trot")
    shorter = trajopt.Solution.load(plan.save(tmp_path / "a.npz"))
    read = loaded([plan, shorter], tmp_path, task="trot and turn", cycles=2)
    assert (read.info["total_episodes"], read.info["splits"]) == (2, {"train": "0:2"})
    assert read.tasks.loc["trot and turn"].task_index == 0
    assert_array_equal(read.column("index")[:, 0], np.arange(read.table.num_rows))
    for number, episode in enumerate(read.episodes):
        first, end = episode["dataset_from_index"], episode["dataset_to_index"]
        rows = slice(first, end)
        assert (episode["episode_index"], episode["length"]) == (number, end - first)
        assert episode["tasks"] == ["trot and turn"]
        assert set(read.column("episode_index")[rows, 0]) == {number}
        assert_array_equal(read.column("frame_index")[rows, 0], np.arange(end - first))
        for key in read.features:
            own = read.column(key)[rows]
            assert_allclose(episode[f"stats/{key}/std"], own.std(axis=0), rtol=1e-4, atol=SINGLE)
            assert {name for name in episode if name.startswith(f"stats/{key}/")} == {
                f"stats/{key}/{name}" for name in STATISTICS
            }
    assert end == read.table.num_rows


def test_each_problem_is_a_task_where_none_is_given(tmp_path: Path) -> None:
    plan = plan_to_export("an arm")
    other = plan.with_description(problem="reach")
    read = loaded([plan, other, plan], tmp_path)
    assert list(read.tasks.index) == [plan.description.problem, "reach"]
    tasks = [task for episode in read.episodes for task in episode["tasks"]]
    assert tasks == [plan.description.problem, "reach", plan.description.problem]


def test_a_single_frame_has_statistics(tmp_path: Path) -> None:
    read = LoadedDataset(export_motion(plan_to_export("turning trot"), "lerobot", tmp_path / "set", rate=1))
    assert read.table.num_rows == 1
    assert set(read.stats["action"]["std"]) == {0.0}


@pytest.mark.parametrize(
    ("kinds", "settings", "words"),
    [
        (["turning trot", "an arm"], {}, "motions of 2 robots: solo12, ur5; allowed: of one"),
        (["planar hops", "an impact"], {}, "allowed: motions with the same joints and contacts"),
        (["an arm"], {"rate": 12.5}, "rate is 12.5 Hz; allowed for lerobot: a whole number"),
        (["an arm"], {"mjcf": "a.xml"}, "mjcf is of no use for lerobot; allowed: task"),
    ],
)
def test_what_a_data_set_cannot_hold_is_refused_in_one_line(
    kinds: list[str], settings: dict[str, Any], words: str, tmp_path: Path
) -> None:
    plans, target = [plan_to_export(kind) for kind in kinds], tmp_path / "set"
    assert_refused_in_one_line(lambda: export_motion(plans, "lerobot", target, **settings), words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["pandas", "pyarrow"])
def test_a_missing_package_is_named_with_its_extra(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    words = f"needs {name}, which is not installed; pip install {name}, or the extra 'data'"
    plan, target = plan_to_export("an arm"), tmp_path / "set"
    assert_refused_in_one_line(lambda: export_motion(plan, "lerobot", target), words)
    assert list(tmp_path.iterdir()) == []
