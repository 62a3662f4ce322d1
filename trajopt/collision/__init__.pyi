from .description import inertia_capsules as inertia_capsules
from .description import robot_shapes as robot_shapes
from .near import CollisionScene as CollisionScene
from .shapes import BoxObstacle as BoxObstacle
from .shapes import CapsuleObstacle as CapsuleObstacle
from .shapes import Obstacle as Obstacle
