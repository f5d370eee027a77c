"""The newest exposure, handed from the cameras to those who wait for one."""

import threading


class Newest:
    """Threads may share it."""

    def __init__(self):
        self._exposure = None
        self._came = threading.Condition()

    def put(self, exposure):
        """Takes the place of the one before; None forgets it."""
        with self._came:
            self._exposure = exposure
            self._came.notify_all()

    @property
    def number(self):
        """The number of the newest one, 0 before there is any."""
        with self._came:
            return 0 if self._exposure is None else self._exposure.number

    def after(self, number, seconds):
        """The newest one if its number is greater, at once or within a time; else None."""
        with self._came:
            is_newer = self._came.wait_for(
                lambda: self._exposure is not None and self._exposure.number > number, seconds
            )
            return self._exposure if is_newer else None
