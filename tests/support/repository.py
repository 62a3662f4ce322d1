"""Where the repository is, in which the tests run."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
