"""Steering while the robot moves: commands to horizons, horizons to motions, motions to torques.

`Controller.step` knows no simulator; `trajopt.simulation` and the command ``trajopt drive`` run it.
"""
