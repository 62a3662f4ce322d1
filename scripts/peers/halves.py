"""Two halves of a comparison, each in an environment of its own: lines of JSON from one to the other."""

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


class Half:
    """The other half, a process that answers requests.

    Args:
        name: for messages.
        command: that starts it, from the root of the repository.
    """

    def __init__(self, name: str, command: str) -> None:
        self.name = name
        environment = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
        words, pipe = shlex.split(command), subprocess.PIPE
        self._process = subprocess.Popen(words, cwd=ROOT, env=environment, stdin=pipe, stdout=pipe, text=True)

    def ask(self, **request: Any) -> dict[str, Any]:
        """The answer to a request; ends this program where the other has ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.name} ended: its message is above")
        return dict(json.loads(line))

    def close(self) -> None:
        """Let it end."""
        self._process.communicate()


def arguments(description: str, tasks: Iterable[str]) -> argparse.Namespace:
    """What the command line of a comparison says: tasks, repeats, how ours is run, and what is written."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("tasks", nargs="*", choices=[[], *tasks], help="default: all")
    parser.add_argument("--repeats", type=int, default=5, help="rounds of solves")
    parser.add_argument("--ours", default=f"uv run --project {ROOT} python", help="python of the project")
    parser.add_argument("--write", action="store_true", help="write docs/peers.md and docs/peers/")
    parser.add_argument("--only-document", action="store_true", help="run nothing: write from the last table")
    return parser.parse_args()


def answer(answers: Mapping[str, Callable[..., dict[str, Any]]]) -> None:
    """Answer requests on stdin, by the word of their "do", until it ends."""
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps(answers[request.pop("do")](**request)), flush=True)
