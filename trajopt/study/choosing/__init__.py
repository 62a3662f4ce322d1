"""Settings chosen from measured fronts for an accuracy or a time, verified, refined where they fall short."""
