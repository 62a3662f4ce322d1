"""A plugin of pytest that takes the engine from the file that TRAJOPT_ENGINE names, see .ci/sanitize."""

import importlib.util
import os
import sys

import casadi  # noqa: F401 - loads the libraries that the engine is linked to

_spec = importlib.util.spec_from_file_location("trajopt._engine", os.environ["TRAJOPT_ENGINE"])
assert _spec is not None
assert _spec.loader is not None
sys.modules["trajopt._engine"] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sys.modules["trajopt._engine"])
