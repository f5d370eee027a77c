"""Starting from what another run has learnt."""

import dataclasses

import pytest
import torch

from mvtop_train.errors import UserError
from mvtop_train.network import config as configs
from mvtop_train.network.model import Mvtop
from mvtop_train.training import checkpoint

OWN_ROWS = ("decoder.heads.0.rotation.4.weight", "features.detector.score.bias")


def network(seed: int, *names: str, hypotheses: int = 2) -> Mvtop:
    torch.manual_seed(seed)
    classes = tuple(configs.ObjectClass(i, name, 0.1) for i, name in enumerate(names, 1))
    return Mvtop(configs.preset("tiny", classes, hypotheses=hypotheses))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A network that knows a nut and a tee, and its file."""
    path = tmp_path_factory.mktemp("run") / "weights.pt"
    model = network(1, "nut", "tee")
    checkpoint.save_weights(model, 7, 7, path)
    return model.state_dict(), path


def started(folder, path, config):
    return checkpoint.TrainingState(folder, config, "cpu", str(path)).model.state_dict()


def rows(weights: dict, name: str, objects: int) -> list[torch.Tensor]:
    return [*weights[name].unflatten(0, (objects, -1))]


def test_of_other_objects_a_network_takes_all_but_what_it_does_not_know(saved, tmp_path):
    given, path = saved
    config = network(2, "tee", "shaft", "bracket").config
    torch.manual_seed(3)
    fresh = checkpoint.TrainingState(tmp_path / "fresh", config, "cpu").model.state_dict()
    torch.manual_seed(3)
    taken = started(tmp_path / "taken", path, config)
    for name, x in taken.items():
        if x.shape == given[name].shape:
            torch.testing.assert_close(x, given[name].half().to(x.dtype), rtol=0, atol=0)
    for name in OWN_ROWS:
        tee, shaft, bracket = rows(taken, name, 3)
        torch.testing.assert_close(tee, rows(given, name, 2)[1].half().float(), rtol=0, atol=0)
        torch.testing.assert_close(shaft, rows(fresh, name, 3)[1], rtol=0, atol=0)
        torch.testing.assert_close(bracket, rows(fresh, name, 3)[2], rtol=0, atol=0)


def test_objects_in_another_order_keep_their_own(saved, tmp_path):
    given, path = saved
    taken = started(tmp_path, path, network(2, "tee", "nut").config)
    for name in OWN_ROWS:
        for one, other in zip(rows(taken, name, 2), rows(given, name, 2)[::-1], strict=True):
            torch.testing.assert_close(one, other.half().float(), rtol=0, atol=0)


def test_another_network_is_one_clear_sentence(saved, tmp_path):
    config = dataclasses.replace(network(2, "shaft").config, d_model=64)
    with pytest.raises(UserError, match="expected weights of this network, got others"):
        started(tmp_path, saved[1], config)
