"""A plan that its simulation does not track, because feet roll, which plans neglect."""

ROLLS = ("quadruped-trot", "go2")
ROLLING = "balls of 24 mm roll under the shanks and carry the base 4 cm on; plans hold the balls' centres"
