"""Every problem on every robot: which pairs there are, how they are run, what was found, what was before."""
