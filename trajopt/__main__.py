"""``python -m trajopt``: the command line."""

import sys

from trajopt.cli import main

sys.exit(main())
