"""Replay of a solution: Meshcat live, or one HTML page that needs no server and no network."""

from trajopt.replay.show import Replay, replay, serve

__all__ = ["Replay", "replay", "serve"]
