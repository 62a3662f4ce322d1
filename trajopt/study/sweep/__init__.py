"""The measured trade-off of speed and accuracy: one problem at many settings, each timed and measured."""
