"""The background's worker with the priority of the tests, which would wait long on a busy machine."""

import sys
from pathlib import Path

from trajopt.transcription import background_worker

if __name__ == "__main__":
    background_worker._step_back = lambda: None
    background_worker.main(Path(sys.argv[1]))
