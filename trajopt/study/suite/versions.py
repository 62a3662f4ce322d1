"""Versions of the libraries and solvers on which a result depends besides the problem."""

import platform
import re
from pathlib import Path

import casadi

from trajopt.versions import installed_version

UNKNOWN = "unknown"


def versions() -> dict[str, str]:
    """Names and versions; IPOPT is that of CasADi's wheel."""
    return {
        "trajopt": installed_version("trajopt"),
        "casadi": installed_version("casadi"),
        "ipopt": ipopt_version(),
        "pin": installed_version("pin"),
        "numpy": installed_version("numpy"),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def ipopt_version() -> str:
    """The version of IPOPT in CasADi's wheel, from the header next to its library."""
    header = Path(casadi.__file__).parent / "include" / "coin-or" / "IpoptConfig.h"
    try:
        match = re.search(r'#define IPOPT_VERSION "([^"]+)"', header.read_text(encoding="utf-8"))
    except OSError:
        match = None
    return match[1] if match else UNKNOWN
