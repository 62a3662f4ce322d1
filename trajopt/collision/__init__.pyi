from .description import inertia_boxes as inertia_boxes
from .description import robot_shapes as robot_shapes
from .near import CollisionScene as CollisionScene
from .near import separable_pairs as separable_pairs
from .shapes import BoxObstacle as BoxObstacle
from .shapes import CapsuleObstacle as CapsuleObstacle
from .shapes import Obstacle as Obstacle
