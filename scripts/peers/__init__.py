"""The same tasks for this library and for its peers, each in an environment of its own."""
