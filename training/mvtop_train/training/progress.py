"""What a run tells of itself, and how far it is."""

import json
import time

from . import processes, runconfig
from .checkpoint import Run


class Meter:
    """Means since the last report. Sums stay on the device, so that no step waits for another."""

    def __init__(self):
        self.sums, self.images, self.waited, self.started = {}, 0, 0.0, time.monotonic()

    def add(self, parts: dict, views: int, images: int, waited: float):
        parts["rotation_deg_multi" if views > 1 else "rotation_deg_one"] = parts["rotation_deg"]
        for name, value in parts.items():
            total, n = self.sums.get(name, (0.0, 0))
            self.sums[name] = (total + value.detach(), n + 1)
        self.images += images
        self.waited += waited

    def report(self) -> dict:
        means = {name: round(float(total) / n, 5) for name, (total, n) in self.sums.items()}
        seconds = time.monotonic() - self.started
        rates = {
            "images_per_s": round(self.images / seconds, 1),
            "waited": round(self.waited / seconds, 3),  # share of the time, for data
        }
        self.__init__()
        return {**means, **rates}


class Log:
    """`log.jsonl` and TensorBoard's files; `--logdir` is the run folder or one above it."""

    def __init__(self, run: Run):
        from torch.utils.tensorboard import SummaryWriter

        self.run, self.path = run, run.folder / "log.jsonl"
        self.writer = SummaryWriter(run.folder, purge_step=run.step + 1 if run.step else None)

    def write(self, record: dict, group: str):
        with open(self.path, "a") as file:
            file.write(json.dumps({"step": self.run.step, **record}) + "\n")
        for name, value in record.items():
            self.writer.add_scalar(f"{group}/{name}", value, self.run.step)
        self.writer.flush()


class Clock:
    """How far a run is, of its steps and of its minutes, whichever is further."""

    def __init__(self, settings: runconfig.RunConfig, run: Run, device: str, alone: bool):
        self.settings, self.run, self.device = settings, run, device
        self.every = 1 if alone else 16  # other processes must be told of the time
        self.before, self.started = run.elapsed, time.monotonic()
        self.fraction = self._look()
        self.begun = self.progress()

    def _look(self) -> float:
        minutes = self.settings.minutes
        if minutes:
            return processes.from_first(self.run.elapsed / 60 / minutes, self.device)
        return 0.0

    def progress(self) -> float:
        """0 to 1 and over; the same in all processes."""
        self.run.elapsed = self.before + time.monotonic() - self.started
        step, steps = self.run.step, self.settings.steps
        if step % self.every == 0:
            self.fraction = self._look()
        return max(self.fraction, step / steps if steps else 0.0)

    def minutes_left(self, progress: float) -> float:
        pace = (self.run.elapsed - self.before) / max(progress - self.begun, 1e-9)
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
