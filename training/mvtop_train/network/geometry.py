"""How positions enter a network."""

from dataclasses import dataclass

from .decoder import Decoder
from .encoder import Encoder


@dataclass(frozen=True)
class Geometry:
    """The two stages that know where things are."""

    encoder: type[Encoder]
    decoder: type[Decoder]


# Positions enter only through lines of sight, so that nothing depends on where an image ends: box
# rays make the queries, offsets are in box units, and what a view contributes is turned into the
# reference frame by the view's own rays (`attention.Lift`).
RAYS = Geometry(Encoder, Decoder)
