"""Weights read back out of a bundle's graphs."""

import dataclasses

import numpy as np
import pytest
import torch
from conftest import random_views

from mvtop_train.data.objects import ball, classes_of
from mvtop_train.errors import UserError
from mvtop_train.export import bundle, integers, restore, self_test
from mvtop_train.network import config
from mvtop_train.network.lite import load_pretrained
from mvtop_train.network.model import Mvtop


def fresh(preset: str) -> Mvtop:
    torch.manual_seed(1)
    made = config.preset(preset, classes_of(ball()), hypotheses=1 if preset == "lite" else 3)
    made = dataclasses.replace(made, width=128, height=96, closeup=64)
    model = Mvtop(made)
    if preset == "lite":
        load_pretrained(model.features)
    return model


def moved(model: Mvtop) -> Mvtop:
    """With all that training changes moved."""
    torch.manual_seed(3)
    with torch.no_grad():
        for x in (x for x in model.parameters() if x.requires_grad):
            x += 0.1 * x.std(correction=0).clamp_min(0.1) * torch.randn_like(x)
        for norm in (m for m in model.train().modules() if isinstance(m, torch.nn.BatchNorm2d)):
            if norm.training:
                norm.running_mean.normal_(0, 0.1)
                norm.running_var.uniform_(0.5, 2)
    return model.eval()


@pytest.fixture(scope="module", params=["lite", "tiny"])
def trained(request):
    return moved(fresh(request.param))


@pytest.fixture(scope="module")
def pictures():
    drawn = np.random.default_rng(0)
    sides = {"features": (96, 128), "closeup": (64, 64)}
    return {
        name: drawn.uniform(-2, 2, (8, 3, *side)).astype(np.float32) for name, side in sides.items()
    }


def answers(model: Mvtop) -> dict[str, np.ndarray]:
    """Of all parts one after the other: what one has wrong, those after it have as well."""
    told = self_test.outputs(self_test.OfModel(model.eval()))
    if model.decoder:  # of the self-test it is given numbers, not what the encoder makes
        config = model.config
        views = random_views(
            dataclasses.replace(config, width=config.closeup, height=config.closeup), 2
        )
        views.inside = torch.ones(1, 2, sum(h * w for h, w in config.decoder_shapes()))
        with torch.no_grad():
            told["rotations"] = model(views).hypotheses[-1].rotation_6d.flatten().tolist()
    return {name: np.array(numbers) for name, numbers in told.items()}


def restored(graphs, preset: str) -> Mvtop:
    given = {}
    for graph in graphs.values():
        given |= restore.weights_of(graph)
    model = fresh(preset)
    restore.put(given, model)
    return model


@pytest.mark.parametrize(("stored", "off"), [("full", 1e-4), ("integers", 0.1)])
def test_a_restored_network_answers_as_the_one_that_was_exported(trained, pictures, stored, off):
    preset = trained.config.preset
    graphs = bundle.graphs_of(bundle.fold_batch_norm(trained))
    if stored == "integers":
        graphs = integers.of_all(graphs, pictures)
        for graph in graphs.values():
            bundle.store_in_bytes(graph)
            bundle.store_in_half(graph)
    expected, got, other = (answers(m) for m in (trained, restored(graphs, preset), fresh(preset)))
    for name, values in expected.items():
        assert np.abs(got[name] - values).max() < off * np.abs(values).max(), name
    differs = (np.abs(other[name] - x).max() / np.abs(x).max() for name, x in expected.items())
    assert max(differs) > 0.2, "twice what 8 bits may change"


def of_closeups(model: Mvtop, pictures: torch.Tensor) -> torch.Tensor:
    features = model.features
    if model.config.gives_coordinates:
        return features.describe(pictures)
    return features.pose_levels(pictures)[0]


def test_normalisation_begins_with_the_statistics_of_pictures(trained, pictures):
    graphs = bundle.graphs_of(bundle.fold_batch_norm(trained))
    model = restored(graphs, trained.config.preset)
    shown = {name: torch.from_numpy(x) for name, x in pictures.items()}

    def changed_by_training() -> float:
        with torch.no_grad():
            settled, trained_on = (
                of_closeups(model.train(mode), shown["closeup"]) for mode in (False, True)
            )
        return float((trained_on - settled).abs().mean() / settled.abs().mean())

    before = answers(model)
    restore.measure_normalisation(model, shown)
    for name, values in answers(model).items():
        np.testing.assert_allclose(values, before[name], rtol=1e-3, atol=1e-5, err_msg=name)
    assert changed_by_training() < 0.1
    model = restored(graphs, trained.config.preset)  # without
    assert changed_by_training() > 0.2


def test_a_restored_network_is_compared_on_pictures(pictures):
    model = moved(fresh("lite"))
    graphs = integers.of_all(bundle.graphs_of(bundle.fold_batch_norm(model)), pictures)
    shown = {name: torch.from_numpy(x) for name, x in pictures.items()}
    restore._compare(model, graphs, shown, "models/own")
    with pytest.raises(UserError, match="models/other: expected (boxes|coordinates) within 0.2 of"):
        restore._compare(fresh("lite").eval(), graphs, shown, "models/other")


def test_other_weights_are_refused(trained, tmp_path):
    bundle.write_bundle(trained, tmp_path, {"trained_steps": 1}, known=(ball(),))
    (tmp_path / "closeup.onnx").write_bytes((tmp_path / "features.onnx").read_bytes())
    with pytest.raises(UserError, match="expected weights of preset '(lite|tiny)', got 'features"):
        restore.of_bundle(tmp_path, (ball(),), tmp_path)
    with pytest.raises(UserError, match=r"knows \['mvball'\], expected \[\]; fix: --data"):
        restore.of_bundle(tmp_path, (), tmp_path)
    with pytest.raises(UserError, match="fix: --bundle must name a bundle's folder"):
        restore.of_bundle(tmp_path / "none", (ball(),), tmp_path)
