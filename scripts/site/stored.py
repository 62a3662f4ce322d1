"""What takes long to make, kept in `build/` until what it is made from changes."""

import hashlib
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

from trajopt.motion.output import replacing

T = TypeVar("T")
ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "site-pages"
SOURCES = ("trajopt", "problems", "robots")


@cache
def _library() -> bytes:
    """Hash of all sources of the library, and of the versions of everything else."""
    files = [path for folder in SOURCES for path in (ROOT / folder).rglob("*.*") if path.suffix != ".pyc"]
    digest = hashlib.sha256()
    for path in [ROOT / "uv.lock", *sorted(files)]:
        digest.update(str(path.relative_to(ROOT)).encode())
        digest.update(path.read_bytes())
    return digest.digest()


def stored(name: str, make: Callable[[], T], source: str | Path) -> T:
    """What ``make`` returns, or did in an earlier build with the same library and the same ``source``."""
    digest = hashlib.sha256(_library() + Path(source).read_bytes())
    entry = FOLDER / f"{name}-{digest.hexdigest()[:16]}"
    if entry.is_file():
        kept: T = pickle.loads(entry.read_bytes())
        return kept
    made = make()
    FOLDER.mkdir(parents=True, exist_ok=True)
    with replacing(entry) as unfinished:
        unfinished.write_bytes(pickle.dumps(made))
    return made
