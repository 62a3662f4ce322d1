"""The parts of a solution's check: samples, figures, re-integration."""
