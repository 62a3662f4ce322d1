"""The notebooks and the examples of problems of one's own run as they are shown."""

import html
import re
import runpy
from functools import partial
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pinocchio as pin
import pytest
from playwright.sync_api import sync_playwright

import trajopt
from scripts.site.notebooks import executed
from scripts.site.stored import stored
from tests.support.browser import require_chromium
from tests.support.problems import reach
from tests.support.repository import ROOT
from trajopt import InputError, Solution, check
from trajopt.view import plots, show
from trajopt.view.replay.browser import FLAGS

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
# Those that solve and check a motion.
MOTIONS = ("arm", "gait", "jump")
# Bytes of a notebook in the repository: without outputs, which are made by running it.
LARGEST = 200_000


@pytest.fixture(scope="module")
def solution() -> Solution:
    return trajopt.solve(reach(), intervals=4)


def test_there_are_notebooks_for_motions_control_and_walking() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["arm", "control", "gait", "jump", "walking"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_valid_and_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_of_a_notebook_lead_somewhere(path: Path) -> None:
    links = re.findall(r"\]\((\.\./[^)#]+)", path.read_text(encoding="utf-8"))
    assert links
    assert all((path.parent / link).exists() for link in links), links


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path) -> None:
    done = stored(path.stem, partial(executed, path), path)
    outputs = [output for cell in done.cells for output in cell.get("outputs", ())]
    assert not [output for output in outputs if output.output_type == "error"]
    kinds = [set(output.get("data", ())) for output in outputs]
    assert sum("image/png" in kind for kind in kinds) >= 2
    if path.stem in MOTIONS:
        assert sum("text/html" in kind for kind in kinds) == 2, "a replay, and two motions in one"
        printed = "".join(output.get("text", "") for output in outputs)
        assert "within all tolerances" in printed


def test_a_replay_is_a_frame_that_holds_its_whole_page(solution: Solution) -> None:
    shown = show(solution, height=300)
    text = shown._repr_html_()
    source = re.fullmatch(r'<iframe srcdoc="([^"]*)" style="[^"]*height: 300px[^"]*"></iframe>', text)
    assert source is not None
    assert html.unescape(source[1]) == shown.page
    assert "default-src 'none'" in shown.page


@pytest.mark.long
def test_a_replay_in_a_frame_plays_in_a_browser(solution: Solution, tmp_path: Path) -> None:
    """Look into the frame from outside, as a notebook has it: the page is ready and seeks."""
    executable = require_chromium()
    page = tmp_path / "notebook.html"
    page.write_text(
        f"<!DOCTYPE html><html><body>{show(solution)._repr_html_()}</body></html>", encoding="utf-8"
    )
    errors: list[str] = []
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=executable, args=list(FLAGS))
        view = chromium.new_page()
        view.on("pageerror", lambda error: errors.append(str(error)))
        view.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        view.goto(page.as_uri())
        frame = view.frames[1]
        frame.wait_for_function("typeof trajopt !== 'undefined'")
        time = solution.t[-1] / 2
        state = frame.evaluate(
            "t => trajopt.ready.then(() => { trajopt.pause(); trajopt.seek(t); return trajopt.state(); })",
            float(time),
        )
        chromium.close()
    assert state["time"] == pytest.approx(time, abs=1e-6)
    assert errors == []


@pytest.mark.long
def test_a_plot_is_a_png(solution: Solution) -> None:
    assert plots(solution)._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("height", "allowed"), [(0, "120 pixels"), (119, "120 pixels"), ("tall", "a whole number")]
)
def test_a_frame_too_low_for_its_controls_is_refused(
    solution: Solution, height: object, allowed: str
) -> None:
    with pytest.raises(InputError, match=allowed):
        show(solution, height=height)  # type: ignore[arg-type]


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
