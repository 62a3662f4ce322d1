"""How accurate a solution is, measured by independent means, and references to compare it with."""
