"""Many cases of a problem, solved on any executor, with their solutions and an index of them in a folder."""
