"""The model of older files: Pinocchio's text, read by a process that may die of it.

The reader of such a text trusts its counts and indices, so that a damaged one ends its process. The process
hands back plain arrays, which are tested as any other input.
"""

import io
import os
import subprocess
import sys
from functools import lru_cache

import numpy as np
import pinocchio as pin

from trajopt.errors import InputError
from trajopt.solution.archive import read_members
from trajopt.solution.model_arrays import MODEL_KINDS, model_from_arrays, model_to_arrays

# Time that the process may take, s, and memory, bytes. A robot's text takes 0.4 s, most of it to start.
LONGEST, LARGEST = 60.0, 4 * 2**30
# Texts whose arrays are kept: the files of one robot are often read one after another.
MOST_TEXTS = 16
# The process imports what this one does, whatever its working directory holds.
_CODE = "import sys; sys.path[:] = sys.argv[1:]; from trajopt.solution.model_text import _answer; _answer()"


def model_from_untrusted_text(text: str) -> pin.Model:
    """The model of a ``pin.Model.saveToString()`` of unknown origin. Raises `InputError`."""
    wrong = InputError("the model in the solution is damaged or of another Pinocchio version")
    try:
        return model_from_arrays(read_members(_arrays(text), "the model", MODEL_KINDS))
    except (InputError, OSError, subprocess.SubprocessError, UnicodeEncodeError):
        raise wrong from None


@lru_cache(maxsize=MOST_TEXTS)
def _arrays(text: str) -> bytes:
    """The answer of the process: an archive of `model_to_arrays`."""
    command = [sys.executable, "-I", "-c", _CODE, *filter(None, sys.path)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    given = text.encode()
    return subprocess.run(
        command, input=given, capture_output=True, check=True, timeout=LONGEST, env=environment
    ).stdout


def _answer() -> None:
    """What the process does: read a text from stdin, write the arrays of its model to stdout."""
    import resource  # not on every system, and needed here alone

    resource.setrlimit(resource.RLIMIT_AS, (LARGEST, LARGEST))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    model, answer = pin.Model(), io.BytesIO()
    model.loadFromString(sys.stdin.buffer.read().decode())
    np.savez(answer, allow_pickle=False, **model_to_arrays(model))
    sys.stdout.buffer.write(answer.getvalue())
    sys.stdout.buffer.flush()
    os._exit(0)  # what a damaged text may have left in memory is not tidied up
