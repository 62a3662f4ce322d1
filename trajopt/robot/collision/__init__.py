"""Links as capsules, obstacles, smooth distances between them, and which pairs are near."""
