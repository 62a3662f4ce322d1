from .description import robot_shapes as robot_shapes
from .link_capsules import robot_capsules as robot_capsules
from .near import CollisionScene as CollisionScene
from .shapes import BoxObstacle as BoxObstacle
from .shapes import CapsuleObstacle as CapsuleObstacle
from .shapes import Obstacle as Obstacle
