"""Replay of a solution: Meshcat live, or one HTML page that needs no server and no network."""
