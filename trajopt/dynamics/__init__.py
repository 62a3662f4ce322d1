"""Rigid-body functions: Pinocchio on CasADi, the manifold, and classical forms to compare with."""

from trajopt.versions import check_installation

# The extension needs the wheels it was compiled against: a mismatch gives a one-line error, not a crash.
check_installation()
