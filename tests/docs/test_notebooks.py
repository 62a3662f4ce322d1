"""The notebooks run from beginning to end; replays and plots are what a notebook shows of a value."""

import html
import re
from functools import partial
from pathlib import Path

import nbformat
import pytest
from playwright.sync_api import sync_playwright

import trajopt
from scripts.site.notebooks import executed
from scripts.site.stored import stored
from tests.support.browser import require_chromium
from tests.support.problems import reach
from tests.support.repository import ROOT
from trajopt.errors import InputError
from trajopt.motion.solution import Solution
from trajopt.view.notebook import plots, show
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
