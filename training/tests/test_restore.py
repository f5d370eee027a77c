"""Weights read back out of a bundle's graphs."""

import numpy as np
import pytest
import torch

from mvtop_train.data.objects import ball, classes_of
from mvtop_train.errors import UserError
from mvtop_train.export import bundle, integers, restore, self_test
from mvtop_train.network import config
from mvtop_train.network.lite import load_pretrained
from mvtop_train.network.model import Mvtop


@pytest.fixture(scope="module")
def trained():
    """A network on the pretrained backbone, with all that training changes moved."""
    model = fresh()
    torch.manual_seed(3)
    with torch.no_grad():
        for x in (x for x in model.parameters() if x.requires_grad):
            x += 0.1 * x.std(correction=0).clamp_min(0.1) * torch.randn_like(x)
        for norm in (m for m in model.train().modules() if isinstance(m, torch.nn.BatchNorm2d)):
            if norm.training:
                norm.running_mean.normal_(0, 0.1)
                norm.running_var.uniform_(0.5, 2)
    return model.eval()


def fresh() -> Mvtop:
    torch.manual_seed(1)
    made = config.preset("lite", classes_of(ball()), width=128, height=96, closeup=64)
    model = Mvtop(made)
    load_pretrained(model.features)
    return model


@pytest.fixture(scope="module")
def pictures(trained):
    drawn = np.random.default_rng(0)
    sides = {"features": (96, 128), "closeup": (64, 64)}
    return {
        name: drawn.uniform(-2, 2, (8, 3, *side)).astype(np.float32) for name, side in sides.items()
    }


def answers(model: Mvtop) -> dict[str, np.ndarray]:
    model.eval()
    return {k: np.array(x) for k, x in self_test.outputs(self_test.OfModel(model)).items()}


def restored(graphs) -> Mvtop:
    given = {}
    for graph in graphs.values():
        given |= restore.weights_of(graph)
    model = fresh()
    restore.put(given, model)
    return model


@pytest.mark.parametrize(("stored", "off"), [("full", 1e-4), ("integers", 0.1)])
def test_a_restored_network_answers_as_the_one_that_was_exported(trained, pictures, stored, off):
    graphs = bundle.graphs_of(bundle.fold_batch_norm(trained))
    if stored == "integers":
        graphs = integers.of_all(graphs, pictures)
        for graph in graphs.values():
            bundle.store_in_bytes(graph)
            bundle.store_in_half(graph)
    expected, got, other = (answers(m) for m in (trained, restored(graphs), fresh()))
    for name, values in expected.items():
        assert np.abs(got[name] - values).max() < off * np.abs(values).max(), name
    turned = np.abs(other["rotation_6d"] - expected["rotation_6d"]).max()
    assert turned > 0.3 * np.abs(expected["rotation_6d"]).max()


def test_normalisation_begins_with_the_statistics_of_pictures(trained, pictures):
    model = restored(bundle.graphs_of(bundle.fold_batch_norm(trained)))
    shown = {name: torch.from_numpy(x) for name, x in pictures.items()}
    before = answers(model)
    restore.measure_normalisation(model, shown)
    for name, values in answers(model).items():
        np.testing.assert_allclose(values, before[name], rtol=1e-3, atol=1e-5, err_msg=name)
    with torch.no_grad():
        settled, trained_on = (
            m.features.describe(shown["closeup"]) for m in (model.eval(), model.train())
        )
    torch.testing.assert_close(trained_on[0][0], settled[0][0], rtol=0.05, atol=0.02)


def test_other_weights_are_refused(trained):
    given = restore.weights_of(bundle.graphs_of(bundle.fold_batch_norm(trained))["decoder"])
    with pytest.raises(UserError, match="expected weights of this network, got others"):
        restore.put(given, fresh())
