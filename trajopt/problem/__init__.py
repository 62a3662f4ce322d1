"""The problem as data: robot, schedule, terms and guess; families with parameters and their catalogue."""
