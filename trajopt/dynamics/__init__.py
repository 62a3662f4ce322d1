"""Rigid-body functions: Pinocchio on CasADi, and the manifold of configurations."""

import lazy_loader

from trajopt.versions import check_installation

# The extension needs the wheels it was compiled against: a mismatch gives a one-line error, not a crash.
check_installation()

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
