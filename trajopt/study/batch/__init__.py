"""Batches: many cases of a problem, solved on any executor, with solutions and their index in a folder."""
