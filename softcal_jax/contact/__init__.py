"""Contact of the body with obstacles and with itself: shapes, and the potential."""

from softcal_jax.contact._contacts import (
    Contacts as Contacts,
    ContactState as ContactState,
    Obstacle as Obstacle,
    Standing as Standing,
    build_contacts as build_contacts,
)
from softcal_jax.contact._facing import (
    build_touching as build_touching,
    face_size as face_size,
)
from softcal_jax.contact._shapes import (
    SHAPES as SHAPES,
    AbstractShape as AbstractShape,
    Ball as Ball,
    Capsule as Capsule,
    DistanceGrid as DistanceGrid,
    HalfSpace as HalfSpace,
    RoundedBox as RoundedBox,
    RoundedCylinder as RoundedCylinder,
    read_surface as read_surface,
)
from softcal_jax.contact._touching import Touching as Touching
