"""The gallery's motions as pages that play, solved when the site is built."""

import multiprocessing
import os
import re
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import trajopt
from trajopt.problem import families

PAGE = "gallery/README.md"
PICTURE = re.compile(r"(?<!\[)!\[([^]]*)\]\(([\w@.-]+)\.webp\)")
# Its solve takes longer than those of all others together.
TOO_LONG = ("biped-jump-forward@g1",)
PROCESSES = 2


def replays(text: str) -> dict[str, bytes]:
    """Replays by path, of the motions that the gallery's page has pictures of."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    names = [name for _, name in PICTURE.findall(text) if name not in TOO_LONG]
    with ProcessPoolExecutor(PROCESSES, multiprocessing.get_context("spawn")) as pool:
        pages = pool.map(_replay, names)
        return {f"gallery/{name}.html": page for name, page in zip(names, pages, strict=True)}


def _replay(name: str) -> bytes:
    """The page of the motion that a picture ``PROBLEM@ROBOT`` shows."""
    problem, robot = name.split("@")
    chosen = {"robot": robot} if families()[problem].takes_robot else {}
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        trajopt.replay(trajopt.solve(trajopt.load(problem, **chosen)), html=page)
        return page.read_bytes()


def with_links(text: str) -> str:
    """The gallery's page with pictures that open the replays."""

    def linked(match: re.Match[str]) -> str:
        if match[2] in TOO_LONG:
            return match[0]
        return f"[{match[0]}]({match[2]}.html){{ target=_blank }}"

    return PICTURE.sub(linked, text)
