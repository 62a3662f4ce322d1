"""Independent judgement of a solution, with numeric Pinocchio alone."""
