"""A browser, and the hop that most tests of replays show."""

from collections.abc import Iterator

import pytest

from tests.support.browser import running_chromium
from tests.support.replay_pages import hopping
from tests.support.synthetic_motions import with_meta
from trajopt.motion.solution import Solution
from trajopt.view.replay.browser import Chromium


@pytest.fixture(scope="package")
def browser() -> Iterator[Chromium]:
    with running_chromium() as running:
        yield running


@pytest.fixture(scope="session")
def hop() -> Solution:
    """Solo12 stands, floats and stands again."""
    return hopping()


@pytest.fixture(scope="session")
def bones(hop: Solution) -> Solution:
    """The hop of a robot without meshes."""
    return with_meta(hop, visual=None)
