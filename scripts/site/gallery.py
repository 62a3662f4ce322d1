"""The gallery's motions as pages that play, solved when the site is built."""

import re
import tempfile
from pathlib import Path

import trajopt
from trajopt.certify.check import BODIES
from trajopt.certify.report import Tolerances
from trajopt.problem import families
from trajopt.solving.graded import first_mesh, solve_graded
from trajopt.solving.solving import solve

PAGE = "gallery/README.md"
PICTURE = re.compile(r"(?<!\[)!\[([^]]*)\]\(([\w@.-]+)\.webp\)")
# Its solve takes longer than those of all others together.
TOO_LONG = ("biped-jump-forward@g1",)
# How deep bodies may be in each other, m, before a picture shows it.
VISIBLE = Tolerances(bodies=1e-2)


def replays(text: str) -> list[str]:
    """Names ``PROBLEM@ROBOT`` of the motions that the gallery's page has pictures of."""
    return [name for _, name in PICTURE.findall(text) if name not in TOO_LONG]


def replay(name: str) -> bytes:
    """The page that plays a motion: on the first mesh; to the grade where bodies are too deep there."""
    family, robot = name.split("@")
    problem = trajopt.load(family, **({"robot": robot} if families()[family].takes_robot else {}))
    solution = solve(problem, mesh=first_mesh(problem), judge=False)
    if not solution.converged:
        solution = trajopt.solve(problem)
    elif not set(BODIES).isdisjoint(trajopt.check(solution, integrate=False).failures(VISIBLE)):
        solution = solve_graded(problem, first=solution).solution
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        trajopt.replay(solution, html=page)
        return page.read_bytes()


def with_links(text: str) -> str:
    """The gallery's page with pictures that open the replays."""
    return PICTURE.sub(
        lambda m: m[0] if m[2] in TOO_LONG else f"[{m[0]}]({m[2]}.html){{ target=_blank }}", text
    )
