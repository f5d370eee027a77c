"""What the first process does beside training: it tells of the run, saves it and validates."""

import json

from tqdm import tqdm

from ..data.batches import Mixed, Scenes
from .checkpoint import TrainingState
from .progress import Clock, Meter, Timer
from .runconfig import RunConfig
from .validate import pose_views, validate


class Log:
    """`log.jsonl` and TensorBoard's files; `--logdir` is the run folder or one above it."""

    def __init__(self, state: TrainingState):
        from torch.utils.tensorboard import SummaryWriter

        self.state, self.path = state, state.folder / "log.jsonl"
        self.writer = SummaryWriter(state.folder, purge_step=state.step + 1 if state.step else None)

    def write(self, record: dict, group: str):
        with open(self.path, "a") as file:
            file.write(json.dumps({"step": self.state.step, **record}) + "\n")
        for name, value in record.items():
            self.writer.add_scalar(f"{group}/{name}", value, self.state.step)
        self.writer.flush()


class Monitor:
    """Logs, saves and validates when it is time, and after the last step."""

    def __init__(
        self, settings: RunConfig, state: TrainingState, scenes: Scenes | Mixed, processes: int
    ):
        self.settings, self.state, self.scenes = settings, state, scenes
        self.processes, self.meter, self.log = processes, Meter(), Log(state)
        self.saving = Timer(settings.save_minutes)
        self.validating = Timer(settings.validate_minutes)
        steps = settings.steps or None
        self.bar = tqdm(total=steps, initial=state.step, unit="step", smoothing=0.02)

    def after_step(self, clock: Clock, progress: float, lr: float, terms: dict, shape, waited):
        """`shape`: scenes of this process's batch, and views of each; `waited` s for it."""
        scenes, views = shape
        self.meter.add(terms, views, scenes * views * self.processes, waited)
        self.bar.update()
        last = progress >= 1
        if self.state.step % self.settings.log_steps == 0 or last:
            self.report(lr, clock.minutes_left(progress))
        if self.saving.due() or last:
            self.state.save()
        decodes = not self.state.config.gives_coordinates
        if decodes and (self.validating.due() or last):
            self.validate()
        if last:
            self.bar.close()

    def report(self, lr: float, left: float):
        means = self.meter.report()
        self.log.write({**means, "lr": lr, "minutes_left": round(left, 1)}, "training")
        pose = (
            f"rot {means.get('rotation_deg_multi', 0):.1f} t {means['translation_m'] * 1e3:.0f} mm "
            if "translation_m" in means
            else ""
        )
        self.bar.set_postfix_str(
            f"loss {means['loss']:.2f} {pose}{means['images_per_s']:.0f} img/s, {left:.0f} min left"
        )

    def validate(self):
        held, average, settings = self.scenes.held, self.state.average, self.settings
        maker = pose_views(settings, average.config, self.scenes.objects, False)
        for views in (1, 2, 3):
            if any(len(scene) >= views for scene in held):
                result = validate(average, held, maker, settings.precision, views)
                self.log.write({"validation_views": views, **result}, f"validation_{views}_views")
                self.bar.write(f"step {self.state.step}, {views} view(s): {json.dumps(result)}")
