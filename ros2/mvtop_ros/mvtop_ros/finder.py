"""One estimator for several callers: one after the other, of whom a few may wait."""

import threading


class BusyError(RuntimeError):
    """So many wait that one more is turned away."""


class Finder:
    """Finds parts in images. Threads may share it."""

    def __init__(self, estimator, waiting):
        """- waiting: callers that may wait while another one's images are worked on"""
        self.estimator = estimator
        self._waiting = waiting
        self._places = threading.BoundedSemaphore(1 + waiting)
        self._turn = threading.Lock()

    def find(self, images, rig, request, tracks=None):
        """The prediction of RGB images by camera id; raises `BusyError` where too many wait.

        - tracks: the `mvtop.Tracks` that numbers the objects over time, if any
        """
        if not self._places.acquire(blocking=False):
            raise BusyError(
                f"expected {self._waiting} waiting requests at most, got one more; ask again later"
            )
        try:
            with self._turn:
                return self.estimator.predict(images, rig, request=request, tracks=tracks)
        finally:
            self._places.release()
