"""Measurements: suites of problems, sweeps over settings, choices from them, diagnosis."""
