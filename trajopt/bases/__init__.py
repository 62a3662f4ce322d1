"""Other coordinates of a robot: virtual joints for a free base, minimal coordinates of a stance."""
