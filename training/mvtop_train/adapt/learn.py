"""A network is trained on, on photographs beside rendered scenes, and becomes a bundle again."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from .. import description
from ..data import batches, bop, objects
from ..data.search import Searches
from ..errors import UserError
from ..export import restore
from ..export.bundle import check_objects
from ..network import config as configs
from ..training import calibrate, checkpoint, loop, pipeline, runconfig, thresholds

OF_RUN = ("data", "backgrounds", "held_out")  # keys of a run's config
OF_THINGS, OF_IMAGES = 0.3, 0.5  # shares of photographs in what is drawn for poses, and for boxes
# Of a run's config. Small steps, as all is learnt already.
TRAINING = {
    "images": 32, "searched": 6, "views": [0.25, 0.35, 0.3, 0.1], "lr": 3e-4, "warmup": 30,
    "held_out": 100,
}  # fmt: skip
FITTED = ("scorer", "pipeline_version", "inference")  # what calibration writes into a bundle


@dataclass(frozen=True)
class Source:
    """A bundle, and what it was made of.

    weights  of its network; None: they are read back out of it
    fields   of the config of a run that trains on; `changes` ("key=value") come on top
    """

    bundle: Path
    weights: Path | None
    fields: dict
    changes: tuple[str, ...] = ()

    @property
    def data(self) -> Path:
        """Data set with its meshes and rendered scenes."""
        return Path(self.fields["data"])

    def known(self) -> tuple[objects.Object, ...]:
        """Its objects; UserError where the data set has others."""
        known = objects.read_all(self.data)
        names = [one["name"] for one in description.read(self.bundle)["classes"]]
        check_objects(f"{self.bundle} knows", names, known)
        return known

    def settings(self, weights: Path) -> runconfig.RunConfig:
        """Of a run that trains on from these weights."""
        _, config, _ = checkpoint.load_weights(weights)
        preset = configs.preset(config.preset, config.classes)
        network = {
            field.name: getattr(config, field.name)
            for field in dataclasses.fields(config)
            if getattr(config, field.name) != getattr(preset, field.name)
        }
        fields = self.fields | {"preset": config.preset, "network": network, "init": str(weights)}
        return runconfig.validated("options", fields, list(self.changes))


def source_of(bundle: Path, weights: Path | None, asked: dict, changes: list[str]) -> Source:
    """Of a bundle that `mvtop_train.run` made, data and weights are beside it; else data must be
    given.

    - asked: keys of a run's config; what is None is as in the run
    """
    about, run = description.read(bundle), runconfig.begun(bundle.parent)
    if configs.preset(about["preset"], ()).shares_backbone:
        raise UserError(
            f"{bundle}: expected a network of preset lite, whose detector learns by itself, got "
            f"{about['preset']}; fix: train one (docs/tutorials/your-own-part.md)"
        )
    of_run = {key: getattr(run, key) for key in OF_RUN} if run else {}
    fields = TRAINING | of_run | {key: value for key, value in asked.items() if value is not None}
    if "data" not in fields:
        raise UserError(
            f"{bundle}: expected the run that made it in the folder above, got none; fix: --data "
            "DIR, rendered scenes of its objects (mvtop-train generate --mesh ...)"
        )
    steps = about.get("provenance", {}).get("trained_steps")
    path = weights or bundle.parent / "weights.pt"
    if weights or path.exists():
        trained = checkpoint.load_weights(path)[2]
        if trained == steps:
            return Source(bundle, path, fields, tuple(changes))
        if weights:
            raise UserError(
                f"{path}: expected weights of {steps} steps, as the bundle's, got {trained}; "
                "fix: those that it was exported from, or leave --weights out"
            )
    return Source(bundle, None, fields, tuple(changes))


def weights_of(source: Source, work: Path) -> Path:
    """Weights to train on from; those that are read back out of a bundle are put into `work`."""
    if source.weights is not None:
        return source.weights
    print(f"{source.bundle}: weights are read back out of it", flush=True)
    model, steps = restore.of_bundle(source.bundle, source.known(), source.data)
    work.mkdir(parents=True, exist_ok=True)
    path = work / "restored.pt"
    checkpoint.save_weights(model, steps, steps, path)
    return path


def train(settings: runconfig.RunConfig, photographs: Path, folder: Path) -> Path:
    """Trains on, in a folder of its own. The weights.

    - photographs: data set as of `labels.write`
    """
    known = settings.known()
    rendered = batches.Scenes(Path(settings.data), known, settings.held_out)
    shown = batches.Scenes(photographs, known, 0)
    loop.train(settings, folder, batches.Mixed(rendered, shown, OF_THINGS, OF_IMAGES))
    return folder / "weights.pt"


def interim(source: Source, settings: runconfig.RunConfig, weights: Path, bundle: Path):
    """A bundle of weights between two iterations, with thresholds and calibration of the source,
    whose evidence means the same."""
    about = description.read(source.bundle)
    detector = about["detector"]
    score = detector["score_threshold"]
    agree = detector.get("agree_threshold", score)
    found = thresholds.Thresholds(score, agree, 0.0, 0.0, 0.0)
    pipeline.export(settings, weights, bundle, found)
    made = description.read(bundle)
    description.write(bundle, made | {key: about[key] for key in FITTED if key in about})


def final(settings: runconfig.RunConfig, weights: Path, bundle: Path, scenes: int) -> bool:
    """The bundle, its thresholds and calibration fitted on held-out rendered scenes; whether these
    were enough to calibrate it.

    - scenes: so many at most
    """
    held = bop.scenes_of(pipeline.held_images(settings))[:scenes]
    model, config, _ = checkpoint.load_weights(weights)
    images = [image for scene in held for image in scene]
    found = thresholds.choose(model, images, Searches(config, settings.known()))
    print(found)
    pipeline.export(settings, weights, bundle, found)
    return calibrate.calibrate(bundle, held, settings.known())
