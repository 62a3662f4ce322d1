"""The examples of problems of one's own: short, shown whole in the documents, and solved as they say."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from tests.support.repository import ROOT
from trajopt import Solution, check

EXAMPLES = ROOT / "docs" / "examples"
PAGES = {
    "box_jump": "write-your-own-problem.md",
    "arm_waypoints": "write-your-own-problem.md",
    "own_terms": "your-own-cost-and-constraint.md",
}
MOST_LINES = 60
# Rows hold to the solver's tolerance at points; between them a millimetre is the check's.
AT_POINTS, BETWEEN = 1e-5, 1e-3
REST = 1e-4


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def solved(name: str) -> tuple[dict[str, Any], Solution]:
    """What an example defines when it is run, and its solution, which passes the check at any time."""
    defined = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    solution = defined["solution"]
    assert solution.success, solution.statistics.advice
    assert check(solution).failures() == ()
    assert Path(f"{name.replace('_', '-')}.npz").is_file()
    return defined, solution


def frame_positions(solution: Solution, frame: str) -> np.ndarray:
    """Positions (K, 3) of a frame at all samples, by Pinocchio and the model in the solution."""
    model = solution.model
    data, index = model.createData(), model.getFrameId(frame)
    found = []
    for q in solution.q:
        pin.framesForwardKinematics(model, data, q)
        found.append(data.oMf[index].translation.copy())
    return np.array(found)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_example_is_short_and_its_page_shows_it_as_it_is(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    page = ROOT / "docs" / "how-to" / PAGES[path.stem]
    assert f"```python\n{text}```\n" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_go2_lands_on_the_box_turned_around_and_clear_of_it() -> None:
    defined, solution = solved("box_jump")
    base = solution.q[-1, :7]
    turn = (
        pin.Quaternion(base[3:7]).toRotationMatrix() @ pin.Quaternion(solution.q[0, 3:7]).toRotationMatrix().T
    )
    np.testing.assert_allclose(turn, np.diag([-1.0, -1.0, 1.0]), atol=BETWEEN)
    risen = base[:3] - solution.q[0, :3]
    np.testing.assert_allclose(risen, [0.0, defined["LEFT"], defined["HEIGHT"]], atol=BETWEEN)
    for contact in defined["robot"].contacts:
        places = frame_positions(solution, contact.frame)
        ground = defined["box"].height(places[:, 0], places[:, 1])
        assert (places[:, 2] - contact.radius - ground).min() > -BETWEEN
    np.testing.assert_allclose(solution.v[-1], 0.0, atol=REST)


@pytest.mark.long
def test_ur5_passes_its_waypoints_in_less_time_than_guessed() -> None:
    defined, solution = solved("arm_waypoints")
    places = frame_positions(solution, defined["TOOL"])
    for waypoint in defined["WAYPOINTS"]:
        assert np.linalg.norm(places - waypoint, axis=1).min() < AT_POINTS
    np.testing.assert_allclose(places[-1], defined["WAYPOINTS"][-1], atol=AT_POINTS)
    assert solution.t[-1] < 0.5 * len(defined["WAYPOINTS"]) * defined["GUESSED"]
    np.testing.assert_allclose(solution.v[-1], 0.0, atol=REST)


@pytest.mark.long
def test_foot_stays_above_the_moving_height_and_the_base_is_low() -> None:
    defined, solution = solved("own_terms")
    lifted = solution.phase == 1
    heights = frame_positions(solution, defined["foot"])[:, 2]
    least = np.array([defined["least_height"](t) for t in solution.t])
    assert (heights - least)[lifted & solution.collocation].min() > -AT_POINTS
    assert (heights - least)[lifted].min() > -BETWEEN
    assert heights.max() > 0.14  # m: the height is really one to rise above
    assert abs(solution.q[-1, 2] - 0.26) < 0.02 < solution.q[0, 2] - 0.26
