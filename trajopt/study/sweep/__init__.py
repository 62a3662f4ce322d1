"""The measured trade between speed and accuracy: one problem at many settings, each timed and measured."""
