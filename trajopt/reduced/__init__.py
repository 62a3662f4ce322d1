"""Smaller models: two stages, one rigid body, the pendulum, and the guesses and scenes made of them."""
