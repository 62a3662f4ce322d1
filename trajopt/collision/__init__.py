"""Collision avoidance: links as capsules, obstacles, smooth distances, and Coal for what is near."""
