"""Means, clock and timers: what a run measures of itself."""

import math
import time

from . import processes
from .checkpoint import TrainingState
from .runconfig import RunConfig


class Meter:
    """Means since the last report. Sums stay on the device, so that no step waits for another."""

    def __init__(self):
        self.reset()

    def reset(self):
        self.sums, self.images, self.waited, self.started = {}, 0, 0.0, time.monotonic()

    def add(self, terms: dict, views: int, images: int, waited: float):
        if "rotation_deg" in terms:
            which = "rotation_deg_multi" if views > 1 else "rotation_deg_one"
            terms = {**terms, which: terms["rotation_deg"]}
        for name, value in terms.items():
            total, n = self.sums.get(name, (0.0, 0))
            self.sums[name] = (total + value.detach(), n + 1)
        self.images += images
        self.waited += waited

    def report(self) -> dict:
        means = {name: round(float(total) / n, 5) for name, (total, n) in self.sums.items()}
        seconds = time.monotonic() - self.started
        means["images_per_s"] = round(self.images / seconds, 1)
        means["waited"] = round(self.waited / seconds, 3)  # share of the time, for data
        self.reset()
        return means


class Clock:
    """How far a run is, of its steps and of its minutes, whichever is further."""

    def __init__(self, settings: RunConfig, state: TrainingState, alone: bool):
        self.steps, self.minutes = settings.steps or math.inf, settings.minutes or math.inf
        self.state, self.before, self.started = state, state.elapsed, time.monotonic()
        self.every = 1 if alone else 16  # other processes must be told of the time
        self.fraction = self._of_minutes()
        self.begun = self.progress()

    def _of_minutes(self) -> float:
        return processes.from_first(self.state.elapsed / 60 / self.minutes, self.state.device)

    def progress(self) -> float:
        """0 to 1 and over; the same in all processes."""
        self.state.elapsed = self.before + time.monotonic() - self.started
        if self.state.step % self.every == 0:
            self.fraction = self._of_minutes()
        return max(self.fraction, self.state.step / self.steps)

    def minutes_left(self, progress: float) -> float:
        pace = (self.state.elapsed - self.before) / max(progress - self.begun, 1e-9)
        return max(1 - progress, 0) * pace / 60


class Timer:
    """True about every `minutes`."""

    def __init__(self, minutes: float):
        self.seconds, self.last = minutes * 60, time.monotonic()

    def due(self) -> bool:
        if time.monotonic() - self.last < self.seconds:
            return False
        self.last = time.monotonic()
        return True
