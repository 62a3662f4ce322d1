"""Driving a robot from the browser: physics and control in real time, commands of a page."""
