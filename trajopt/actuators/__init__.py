"""Motors and gears on joints, and links as beams."""
