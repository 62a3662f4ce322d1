"""What takes long to make, kept in `build/` until a source file of the library changes."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "site-pages"
SOURCES = ("trajopt", "problems", "robots", "notebooks", "scripts/site")


@cache
def _digest() -> str:
    """Hash of all sources, and of the versions of everything else."""
    files = [path for folder in SOURCES for path in (ROOT / folder).rglob("*.*") if path.suffix != ".pyc"]
    digest = hashlib.sha256()
    for path in [ROOT / "uv.lock", ROOT / "docs/gallery/README.md", *sorted(files)]:
        digest.update(str(path.relative_to(ROOT)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def stored(name: str, make: Callable[[], dict[str, bytes]]) -> dict[str, bytes]:
    """Files by path that ``make`` returns, from an earlier build of the same sources if there is one."""
    folder = FOLDER / _digest() / name
    complete = folder.with_suffix(".complete")
    if not complete.is_file():
        for path, data in make().items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        complete.touch()
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
