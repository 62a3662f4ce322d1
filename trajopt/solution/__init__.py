"""The motion that was found, and its file."""
