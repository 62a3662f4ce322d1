"""Some hundred damaged files: each is checked or refused in one line; none ends or holds up its process."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.damaged_files import KINDS, damaged
from tests.support.repository import ROOT
from tests.support.synthetic_motions import arm_motion, sampled, standing
from trajopt.collision.description import robot_shapes
from trajopt.collision.shapes import BoxObstacle, SphereObstacle
from trajopt.terrain import PiecewiseTerrain
from trajopt_library import robots

CASES = 80  # of each kind
SEED = 0
LONGEST = 600  # s, for all cases of a kind


@pytest.fixture(scope="module")
def contents() -> list[bytes]:
    """Files of an arm, and of a robot with shapes on stairs, beside obstacles."""
    arm, solo12 = robots.load("ur5"), robots.load("solo12")
    bodies = robot_shapes(solo12).describe() | {"margins": None}
    obstacles = [
        SphereObstacle(name="ball", centre=np.array([1.0, 0.0, 0.0]), radius=0.1).describe(),
        BoxObstacle(name="box", sides=np.full(3, 0.2), position=np.array([0.0, 1.0, 0.0])).describe(),
    ]
    scene = {"capsules": [], "obstacles": obstacles, "self_pairs": []}
    stairs = PiecewiseTerrain.stairs(0.1, 0.3, 2, at=(1.0, 0.0)).describe()
    motion = sampled(solo12, [standing(solo12, 0.2)], 2, bodies=bodies, terrain=stairs, collision=scene)
    return [motion.to_bytes(), sampled(arm, [arm_motion(arm)], 2).to_bytes()]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_checked_or_refused(kind, contents, tmp_path):
    random = np.random.default_rng([SEED, list(KINDS).index(kind)])
    paths = []
    for number in range(CASES):
        path = tmp_path / f"{kind}{number}.npz"
        path.write_bytes(damaged(kind, contents[number % 4 == 3], random))
        paths.append(path)
    outcomes = outcomes_of(paths)
    wrong = {name: outcome for name, outcome in outcomes.items() if outcome not in ("report", "refused")}
    assert not wrong
    assert len(outcomes) == CASES


def outcomes_of(paths: list[Path]) -> dict[str, str]:
    """How each file went; of one that ended its process the signal, and the others go on in a new one."""
    outcomes: dict[str, str] = {}
    while len(outcomes) < len(paths):
        left = [str(path) for path in paths[len(outcomes) :]]
        command = [sys.executable, "-m", "tests.support.damaged_files", *left]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LONGEST)
        for line in done.stdout.splitlines():
            word, name, *outcome = line.split(" ", 2)
            outcomes[name] = outcome[0] if word == "ends" else f"process ended with {done.returncode}"
        if not done.stdout:
            raise AssertionError(done.stderr)
    return outcomes
