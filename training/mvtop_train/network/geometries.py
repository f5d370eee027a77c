"""The geometries that a config may name (`Config.geometry`)."""

from .geometry import RAYS, Geometry
from .paper import IMAGE
from .voting import IMAGE_HYPOTHESES

GEOMETRIES = {"rays": RAYS, "image": IMAGE, "image_hypotheses": IMAGE_HYPOTHESES}


def geometry_of(config) -> Geometry:
    return GEOMETRIES[config.geometry]
