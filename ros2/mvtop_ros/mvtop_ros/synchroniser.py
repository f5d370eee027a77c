"""Images of one moment, of the images that cameras send one by one."""

from collections import deque
from dataclasses import dataclass
from typing import Any

# Images of a camera that wait for those of others.
_KEPT = 10


@dataclass(frozen=True)
class Exposure:
    """Images of one moment."""

    number: int
    """Counts up."""
    stamp_s: float
    """Of the latest of its images, seconds."""
    messages: dict[str, Any]
    """By camera."""


class Synchroniser:
    """Makes exposures of images whose times are near each other.

    A camera is not waited for while others have sent images for a while that it should have sent,
    too. Between exposures all may be silent.
    """

    def __init__(self, cameras, *, slop_s, min_cameras, silent_after_s):
        """
        - slop_s: greatest time between two images of an exposure
        - min_cameras: fewest images of one
        - silent_after_s: how long images wait for a camera
        """
        self._slop_s = slop_s
        self._min_cameras = min_cameras
        self._silent_after_s = silent_after_s
        self._waiting = {camera: deque(maxlen=_KEPT) for camera in cameras}
        self._heard_s = {}
        # When the first image came that waits for a camera.
        self._awaited_s = {}
        self._count = 0

    def add(self, camera, stamp_s, now_s, message):
        """Takes over an image; returns the `Exposure` that it completes, else None.

        - now_s: when it came, seconds of a clock that never goes back
        """
        self._heard_s[camera] = now_s
        self._awaited_s.pop(camera, None)
        for other in self._waiting:
            if other != camera:
                self._awaited_s.setdefault(other, now_s)
        waiting = self._waiting[camera]
        if waiting and stamp_s < waiting[-1][0]:
            waiting.clear()  # time has begun anew
        waiting.append((stamp_s, message))
        return self._complete(stamp_s, now_s)

    def poll(self, now_s):
        """The `Exposure` of images that have waited long enough, else None."""
        newest = [images[-1] for images in self._waiting.values() if images]
        if not newest:
            return None
        return self._complete(max(stamp for stamp, _ in newest), now_s)

    def _complete(self, stamp_s, now_s):
        chosen = {}
        for other, images in self._waiting.items():
            near = min(images, key=lambda image: abs(image[0] - stamp_s), default=None)
            if near is not None and abs(near[0] - stamp_s) <= self._slop_s:
                chosen[other] = near
        missing = self.missing(now_s)
        if any(other not in chosen and other not in missing for other in self._waiting):
            return None
        stamps = [stamp for stamp, _ in chosen.values()]
        if len(chosen) < self._min_cameras or max(stamps) - min(stamps) > self._slop_s:
            return None
        for other, (stamp, _) in chosen.items():
            images = self._waiting[other]
            while images and images[0][0] <= stamp:
                images.popleft()
            self._awaited_s.pop(other, None)
        self._count += 1
        messages = {other: chosen[other][1] for other in self._waiting if other in chosen}
        return Exposure(self._count, max(stamps), messages)

    def missing(self, now_s):
        """The cameras that are not waited for."""
        late = self._silent_after_s
        return [name for name, since_s in self._awaited_s.items() if now_s - since_s > late]

    def silent(self, now_s):
        """The cameras that have sent nothing for a while, or never."""
        never = -float("inf")
        late = self._silent_after_s
        return [name for name in self._waiting if now_s - self._heard_s.get(name, never) > late]
