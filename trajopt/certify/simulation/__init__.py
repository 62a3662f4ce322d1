"""Plans in MuJoCo: the same robot, contacts of finite stiffness, and a controller that tracks the plan."""
