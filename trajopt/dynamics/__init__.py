"""Rigid-body functions: Pinocchio on CasADi, the manifold, and classical forms to compare with."""

from trajopt.versions import check_installation

# The extension loads only beside the wheels that it was compiled against: said in one line, not by a crash.
check_installation()
