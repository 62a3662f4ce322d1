"""Robot reports, with figures and likely mistakes; a first robot file from a URDF or MJCF file."""
