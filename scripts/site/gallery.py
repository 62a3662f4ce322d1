"""The gallery's motions as pages that play, solved when the site is built."""

import re
import tempfile
from pathlib import Path

import trajopt
from trajopt.problem import families

PAGE = "gallery/README.md"
PICTURE = re.compile(r"(?<!\[)!\[([^]]*)\]\(([\w@.-]+)\.webp\)")


def replays(text: str) -> list[str]:
    """Names ``PROBLEM@ROBOT`` of the motions that the gallery's page has pictures of."""
    return [name for _, name in PICTURE.findall(text)]


def replay(name: str) -> bytes:
    """The page that plays the motion of a picture ``PROBLEM@ROBOT``."""
    problem, robot = name.split("@")
    chosen = {"robot": robot} if families()[problem].takes_robot else {}
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        trajopt.replay(trajopt.solve(trajopt.load(problem, **chosen)), html=page)
        return page.read_bytes()


def with_links(text: str) -> str:
    """The gallery's page with pictures that open the replays."""
    return PICTURE.sub(r"[\g<0>](\2.html){ target=_blank }", text)
