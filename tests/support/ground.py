"""Ground for tests: stairs, and hills of every shape."""

from trajopt.terrain.piecewise import PiecewiseTerrain
from trajopt.terrain.shapes import Bump, Incline, Ramp, Wave
from trajopt.terrain.smooth import SmoothTerrain

STAIRS = PiecewiseTerrain.stairs(0.1, 0.3, 3, width=1.0)
HILLS = SmoothTerrain(
    shapes=(
        Bump(rise=0.2, radius=0.5, centre=(0.3, -0.2)),
        Incline(level=0.05, slope_x=0.1, slope_y=-0.2),
        Ramp(rise=0.3, length=0.6, at=(1.0, 0.0), yaw=0.4),
        Wave(amplitude=0.05, wavelength=0.8, yaw=-0.7),
    ),
    friction=0.6,
)
