"""Classical forms of the dynamics as taught in lectures, for learning and for comparison.

These are Lagrange's equations from the energies of the links, the recursive Newton-Euler method link by link,
the Newton-Euler equations of the whole robot, the structure of the mass matrix, and projected dynamics. No
solver, check or command uses them: problems are built on `trajopt.dynamics`. Lagrange's equations and the
recursion are derived without Pinocchio's algorithms, and agree with them for every kind of joint.
docs/modelling/structure.md maps the functions to the equations of the lectures.

Lagrange: `kinetic_energies`, `potential_energies`, `inertia_matrix`, `coriolis_matrix`, `gravity_forces`,
    `equations_of_motion`; CasADi functions.
Newton-Euler: `joint_forces`, numeric; `recursive_newton_euler`, a CasADi function.
Whole robot: `whole_body_balance`, `momentum_maps`, `momentum_matrix`, `composite_inertia`.
Mass matrix: `mass_blocks`, `mass_matrix_rate`, `coriolis_matrix_at`, `kinetic_energy_parts`,
    `gravity_vector`, `gravity_from_base_columns`.
Bounds of its eigenvalues: `a_priori_bounds`, `eigenvalue_range`, `random_postures`.
Contacts without their forces: `projected_forward_dynamics`, `projected_inverse_dynamics`,
    `least_norm_inverse_dynamics`, `null_space_projector`, `consistent_projector`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
