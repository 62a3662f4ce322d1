"""How long a picture of a replay takes, by size: python -m scripts.rendering_cost FILE [PICTURES]."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from trajopt.solution.solution import Solution
from trajopt.view.replay.browser import chromium
from trajopt.view.replay.show import replay

SIZES = ((480, 270), (640, 360), (1280, 720), (1920, 1080))
PICTURES = 20
RENDERER = """(() => {
    const gl = trajopt.viewer.renderer.getContext(), names = gl.getExtension("WEBGL_debug_renderer_info");
    return gl.getParameter(names.UNMASKED_RENDERER_WEBGL);
})()"""


def main() -> None:
    """Print seconds on the clock and of all processors for a picture of each size."""
    solution = Solution.load(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) > 2 else PICTURES
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        page = Path(folder, "page.html")
        replay(solution, html=page)
        print(f"{'size':>10} {'open':>7} {'picture':>8} {'processors':>11}   s")
        for size in SIZES:
            start = time.perf_counter()
            with browser.opened(page, size, "t=0&panel=off") as view:
                ready, busy = time.perf_counter(), processor_seconds()
                for t in np.linspace(view.start, view.start + view.duration, count):
                    view.seek(t)
                    view.png()
                each, used = time.perf_counter() - ready, processor_seconds() - busy
                renderer = view.evaluate(RENDERER)
            print(
                f"{size[0]:5}x{size[1]:<4} {ready - start:7.2f} {each / count:8.3f} {used / count:11.3f}",
                flush=True,
            )
    print(f"drawn by {renderer}")


def processor_seconds() -> float:
    """Seconds that this process and all it has started have computed (Linux only)."""
    parents, used = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        number = int(path.parent.name)
        parents[number] = int(fields[1])
        used[number] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    total, mine = 0.0, {os.getpid()}
    while mine:
        total += sum(used[number] for number in mine)
        mine = {number for number, parent in parents.items() if parent in mine}
    return total


if __name__ == "__main__":
    main()
