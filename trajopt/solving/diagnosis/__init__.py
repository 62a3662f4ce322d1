"""What is wrong with an optimisation problem at an iterate, in words, and what to try."""
