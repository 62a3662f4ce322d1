"""Data sets for LeRobot v3.0, as its ``LeRobotDataset`` reads them: motions are episodes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from trajopt.errors import InputError
from trajopt.export.archives import frame_rate
from trajopt.export.exported_motion import ExportedMotion, require_one_robot
from trajopt.export.formats import package_of_format

# Version of the layout, and its limits: files per folder, and file sizes at which a new file begins.
VERSION, FILES, FILE_SIZE_MB, VIDEO_SIZE_MB = "v3.0", 1000, 100, 200
CHUNK = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, EPISODES = f"data/{CHUNK}.parquet", f"meta/episodes/{CHUNK}.parquet"
FIRST = {"chunk_index": 0, "file_index": 0}
# Quantiles in the statistics, by the names with which policies normalise.
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
# Quantiles are values of the data, as in LeRobot's own binned counts.
METHOD: Final = "inverted_cdf"
EXTRA = "data"
AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True, eq=False)
class Feature:
    """Values of all frames: (n, k) float32 with names of the k entries, or (n,) without names."""

    values: np.ndarray
    names: tuple[str, ...] | None = None

    @property
    def size(self) -> int:
        """Number of entries."""
        return 1 if self.names is None else len(self.names)

    @property
    def described(self) -> dict[str, Any]:
        """Its entry in ``features`` of info.json."""
        names = None if self.names is None else list(self.names)
        return {"dtype": str(self.values.dtype), "shape": [self.size], "names": names}


def write_lerobot(motions: Sequence[ExportedMotion], path: Path, options: Mapping[str, Any]) -> None:
    """Write motions of one robot, one after the other; each episode starts at 0 s.

    Raises `InputError` for motions with different joints or contacts, a rate that is not a whole number, and
    without pandas and pyarrow.
    """
    require_one_robot(motions)
    rate = frame_rate(motions[0].rate)
    if not np.issubdtype(rate.dtype, np.integer):
        raise InputError(f"rate is {float(rate):g} Hz", "allowed for lerobot: a whole number")
    tasks = list(dict.fromkeys(_task(motion, options) for motion in motions))
    episodes, start = [], 0
    for number, motion in enumerate(motions):
        task = tasks.index(_task(motion, options))
        episodes.append(_features_of(motion, episode=number, start=start, task=task))
        start += len(motion.t)
    _require_same_features(episodes)
    joined = {key: np.concatenate([episode[key].values for episode in episodes]) for key in episodes[0]}
    _write_info(path, episodes, motions, len(tasks), int(rate))
    _write_json(path / "meta/stats.json", {key: _statistics(values) for key, values in joined.items()})
    _write_tasks(path / "meta/tasks.parquet", tasks)
    _write_rows(path / EPISODES.format(**FIRST), _described_episodes(episodes, tasks))
    _write_frames(path / DATA.format(**FIRST), episodes[0], joined)


def _task(motion: ExportedMotion, options: Mapping[str, Any]) -> str:
    return str(options.get("task", motion.problem))


def _features_of(motion: ExportedMotion, *, episode: int, start: int, task: int) -> dict[str, Feature]:
    """Features of a motion by name, without empty ones; ``start``: index of its first frame."""
    frames, count = np.arange(len(motion.t)), len(motion.t)
    features = {
        "observation.state": _vector(
            np.hstack([motion.joints.position, motion.joints.velocity]),
            [f"{name}.pos" for name in motion.joints.names] + [f"{name}.vel" for name in motion.joints.names],
        ),
        "action": _vector(motion.drive_torque, [f"{name}.torque" for name in motion.torque_names]),
        **_base_features(motion),
        **_contact_features(motion),
        "timestamp": Feature(values=(frames / motion.rate).astype(np.float32)),
        "frame_index": Feature(values=frames),
        "episode_index": Feature(values=np.full(count, episode)),
        "index": Feature(values=start + frames),
        "task_index": Feature(values=np.full(count, task)),
    }
    return {key: feature for key, feature in features.items() if feature.size}


def _vector(values: np.ndarray, names: list[str]) -> Feature:
    return Feature(values=values.astype(np.float32), names=tuple(names))


def _base_features(motion: ExportedMotion) -> dict[str, Feature]:
    """Pose and velocity of the base link of a moving base, world axes; quaternion xyzw."""
    links, base = motion.links, motion.links.base
    if base is None:
        return {}
    pose = np.hstack([links.position[:, base], links.quaternion[:, base][:, [1, 2, 3, 0]]])
    velocity = np.hstack([links.linear_velocity[:, base], links.angular_velocity[:, base]])
    twist = [f"{part}.{axis}" for part in ("linear", "angular") for axis in AXES]
    return {
        "observation.base_pose": _vector(pose, [*AXES, "qx", "qy", "qz", "qw"]),
        "observation.base_velocity": _vector(velocity, twist),
    }


def _contact_features(motion: ExportedMotion) -> dict[str, Feature]:
    """Active contacts, forces, and moments of soles and rolling balls; world axes."""
    frames, count = motion.contact_frames, len(motion.t)
    turning = np.flatnonzero(motion.description.soles | motion.description.rolling).tolist()
    force = motion.f[..., :3].reshape(count, -1)
    moment = motion.f[:, turning, 3:].reshape(count, -1)
    return {
        "observation.contacts": _vector(motion.active, list(frames)),
        "observation.contact_forces": _vector(force, [f"{name}.{axis}" for name in frames for axis in AXES]),
        "observation.contact_moments": _vector(
            moment, [f"{frames[i]}.{axis}" for i in turning for axis in AXES]
        ),
    }


def _require_same_features(episodes: Sequence[Mapping[str, Feature]]) -> None:
    first = {key: feature.names for key, feature in episodes[0].items()}
    for number, episode in enumerate(episodes):
        columns = {key: feature.names for key, feature in episode.items()}
        for key in sorted(set(first) | set(columns)):
            if first.get(key) != columns.get(key):
                raise InputError(
                    f"'{key}' of motion {number} has other entries than that of motion 0",
                    "allowed: motions with the same joints and contacts",
                )


def _write_info(
    path: Path,
    episodes: Sequence[Mapping[str, Feature]],
    motions: Sequence[ExportedMotion],
    tasks: int,
    rate: int,
) -> None:
    info = {
        "codebase_version": VERSION,
        "robot_type": motions[0].robot,
        "total_episodes": len(motions),
        "total_frames": sum(len(motion.t) for motion in motions),
        "total_tasks": tasks,
        "chunks_size": FILES,
        "data_files_size_in_mb": FILE_SIZE_MB,
        "video_files_size_in_mb": VIDEO_SIZE_MB,
        "fps": rate,
        "splits": {"train": f"0:{len(motions)}"},
        "data_path": DATA,
        "video_path": None,
        "features": {key: feature.described for key, feature in episodes[0].items()},
    }
    _write_json(path / "meta/info.json", info)


def _described_episodes(
    episodes: Sequence[Mapping[str, Feature]], tasks: Sequence[str]
) -> list[dict[str, Any]]:
    """One row per episode: its frames, the place of its data, and statistics of its features."""
    rows = []
    for number, episode in enumerate(episodes):
        index = episode["index"].values
        row = {
            "episode_index": number,
            "tasks": [tasks[int(episode["task_index"].values[0])]],
            "length": len(index),
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": int(index[0]),
            "dataset_to_index": int(index[-1]) + 1,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for key, feature in episode.items():
            row |= {f"stats/{key}/{name}": value for name, value in _statistics(feature.values).items()}
        rows.append(row)
    return rows


def _statistics(values: np.ndarray) -> dict[str, list[Any]]:
    """Statistics of a feature (n, k) over its frames, as lists (k,); ``count``: number of frames."""
    columns = values.reshape(len(values), -1).astype(values.dtype if values.dtype.kind == "i" else float)
    statistics = {
        "min": columns.min(axis=0),
        "max": columns.max(axis=0),
        "mean": columns.mean(axis=0),
        "std": columns.std(axis=0),
        "count": np.array([len(columns)]),
    }
    statistics |= {
        name: np.quantile(columns, level, axis=0, method=METHOD) for name, level in QUANTILES.items()
    }
    return {name: value.tolist() for name, value in statistics.items()}


def _write_json(path: Path, described: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(described, indent=4) + "\n", encoding="utf-8")


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks with their texts as the index: readers look up numbers by text."""
    package_of_format("pyarrow", EXTRA)
    table = package_of_format("pandas", EXTRA).DataFrame({"task_index": range(len(tasks))}, index=list(tasks))
    table.to_parquet(path)


def _write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    arrow, parquet = package_of_format("pyarrow", EXTRA), package_of_format("pyarrow.parquet", EXTRA)
    path.parent.mkdir(parents=True)
    parquet.write_table(arrow.Table.from_pylist(rows), path)


def _write_frames(path: Path, features: Mapping[str, Feature], joined: Mapping[str, np.ndarray]) -> None:
    """Write one row per frame: vectors as lists of fixed size, single entries as numbers."""
    arrow, parquet = package_of_format("pyarrow", EXTRA), package_of_format("pyarrow.parquet", EXTRA)
    columns = {}
    for key, values in joined.items():
        flat = arrow.array(values.ravel(), type=arrow.from_numpy_dtype(values.dtype))
        size = features[key].size
        columns[key] = flat if size == 1 else arrow.FixedSizeListArray.from_arrays(flat, size)
    path.parent.mkdir(parents=True)
    parquet.write_table(arrow.table(columns), path)
