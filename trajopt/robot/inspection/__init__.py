"""What a robot is and what looks wrong with it; a first robot file from a URDF."""
