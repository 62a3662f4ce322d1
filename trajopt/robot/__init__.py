"""The robot: its model, contacts, limits and reference posture; actuators, bases and collision shapes."""
