"""Models of older files: Pinocchio's text, read in a separate process that may crash.

Pinocchio's text reader trusts counts and indices, so a damaged text can crash its process. The process
returns plain arrays, which are checked like any other input.
"""

import io
import os
import subprocess
import sys
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.motion.archive import read_members
from trajopt.motion.model_arrays import MODEL_KINDS, model_from_arrays, model_to_arrays

# Limits of the process: time, s, and memory, bytes. A robot's text takes 0.4 s, mostly to start.
READER_TIME, READER_MEMORY = 60.0, 4 * 2**30
# Number of texts whose arrays are cached: files of one robot are often read in sequence.
MOST_TEXTS = 16
# The process has the same import path as this one, regardless of its working directory.
_CODE = "import sys; sys.path[:] = sys.argv[1:]; from trajopt.motion.model_text import _answer; _answer()"


def model_from_untrusted_text(text: str) -> pin.Model:
    """Return the model from an untrusted ``pin.Model.saveToString()``; raises `InputError`."""
    wrong = InputError("the model in the solution is damaged or of another Pinocchio version")
    try:
        return model_from_arrays(read_members(_arrays(text), "the model", MODEL_KINDS))
    except (InputError, OSError, subprocess.SubprocessError, UnicodeEncodeError):
        raise wrong from None


@lru_cache(maxsize=MOST_TEXTS)
def _arrays(text: str) -> bytes:
    """Return the output of the process: an archive of `model_to_arrays`."""
    command = [sys.executable, "-I", "-c", _CODE, *filter(None, sys.path)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    given = text.encode()
    return subprocess.run(
        command, input=given, capture_output=True, check=True, timeout=READER_TIME, env=environment
    ).stdout


def _answer() -> None:
    """Read a text from stdin and write the arrays of its model to stdout; runs in the process."""
    import resource  # not available on every system

    resource.setrlimit(resource.RLIMIT_AS, (READER_MEMORY, READER_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    model, answer = pin.Model(), io.BytesIO()
    model.loadFromString(sys.stdin.buffer.read().decode())
    np.savez(answer, allow_pickle=False, **model_to_arrays(model))
    sys.stdout.buffer.write(answer.getvalue())
    sys.stdout.buffer.flush()
    os._exit(0)  # skip the cleanup of memory that a damaged text may have corrupted
