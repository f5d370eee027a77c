from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from mvtop._estimator import Estimator
from mvtop._inputs import boxes_by_camera, images_by_camera
from mvtop._mvtop import NativeTracker, Rig
from mvtop._prediction import Prediction, Source
from mvtop._printable import refused
from mvtop._request import json_of

if TYPE_CHECKING:
    from mvtop._inputs import Boxes, Images
    from mvtop._request import Request


class Tracker:
    """Keeps the latest image of each camera of a rig, and what the network has said of it, so that
    a new image of one camera does not compute those of the others again.

    A prediction is that of `Estimator.predict` on the same images, but that each object has a
    `track_id`. An object is the same as the nearest one of its class in earlier predictions, if it
    moved by less than the bound; no number is given twice. Threads may share a tracker: its calls
    run one after the other. It is used in the process that it was made in.

    Parameters
    ----------
    estimator
        What predicts.
    rig
        The cameras.
    max_motion_m
        Farthest that an object moves between two predictions, metres; None: half its diameter.
    patience
        Predictions after which an object that is not found any more is forgotten.

    Raises
    ------
    ValueError
        Where `max_motion_m` is below 0 or not finite.
    """

    def __init__(
        self,
        estimator: Estimator,
        rig: Rig,
        *,
        max_motion_m: float | None = None,
        patience: int = 30,
    ) -> None:
        self._estimator = estimator._here()
        self._rig = rig
        self._native = NativeTracker(self._estimator, rig, max_motion_m, patience)
        self._images: dict[int, Any] = {}
        # Without it, a prediction would be drawn onto images that came while it was computed.
        self._lock = threading.Lock()

    def update(self, images: Images) -> None:
        """Takes over new images, each in the place of the one of its camera.

        Parameters
        ----------
        images
            As in `Estimator.predict`, one group: in a dict by camera id, other cameras keep theirs.

        Raises
        ------
        ValueError
            Where they do not fit the rig; none is then taken over.
        """
        new = images_by_camera(images, self._rig)
        with self._lock:
            self._native.update(new)
            self._images |= new

    def predict(
        self,
        *,
        reference: str | None = None,
        boxes: Boxes | None = None,
        min_views: int | None = None,
        refine: bool | None = None,
        request: Request | None = None,
    ) -> Prediction:
        """Finds objects and their poses in the latest image of each camera.

        Parameters
        ----------
        reference, boxes, min_views, refine, request
            As in `Estimator.predict`.

        Returns
        -------
        Prediction

        Raises
        ------
        ValueError
            As `Estimator.predict`, and where no camera has an image yet.
        """
        given, asked = boxes_by_camera(boxes), json_of(request)
        with self._lock:
            prediction = self._native.predict(asked, reference, given, min_views, refine)
            shown = sorted(self._images.items(), key=lambda of: of[0])
        return Prediction.of(self._rig, Source(self._estimator, prediction, shown)).warn(2)

    def remove(self, camera: str) -> None:
        """Forgets the image of a camera: of one that is off, say.

        Parameters
        ----------
        camera
            Its id.

        Raises
        ------
        ValueError
            Where the rig has no such camera.
        """
        ids = [known.id for known in self._rig.cameras]
        if camera not in ids:
            raise refused(
                f"camera: expected one of {', '.join(ids)}, as in the rig, got `{camera}`"
            )
        with self._lock:
            self._native.remove(ids.index(camera))
            self._images.pop(ids.index(camera), None)

    def __repr__(self) -> str:
        return f"Tracker({len(self._images)} of {len(self._rig.cameras)} cameras)"
