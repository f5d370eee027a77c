"""Steps of the optimiser, and which weights take which."""

import copy

import numpy as np
import pytest
import torch

from mvtop_train.data.objects import ball, classes_of
from mvtop_train.network import config
from mvtop_train.network.model import Mvtop
from mvtop_train.training import optimiser
from mvtop_train.training.checkpoint import TrainingState
from mvtop_train.training.optimise import descend


@pytest.mark.parametrize("shape", [(20, 50), (50, 20), (30, 30)])
def test_singular_values_become_about_one(shape):
    torch.manual_seed(0)
    matrix = torch.randn(shape) * 1e-3
    values = torch.linalg.svdvals(optimiser.orthogonal(matrix))
    assert 0.6 < values.min() and values.max() < 1.3


def test_a_weak_direction_is_learnt_as_fast_as_a_strong_one():
    found = optimiser.orthogonal(torch.diag(torch.tensor([3.0, 0.3])))
    assert found[0, 0] == pytest.approx(found[1, 1].item(), rel=0.5)
    assert found[0, 1].abs() < 0.01


def test_a_step_is_as_large_as_one_of_adamw():
    torch.manual_seed(0)
    for shape in ((64, 200, 1, 1), (200, 64, 1, 1), (32, 24, 3, 3)):
        weight = torch.nn.Parameter(torch.zeros(shape))
        weight.grad = torch.randn(shape) * 1e-4
        optimiser.Muon([{"params": [weight], "lr": 0.01}]).step()
        # By hand: n orthonormal rows of m have a root mean square of 1 / sqrt(m).
        assert weight.square().mean().sqrt().item() == pytest.approx(0.01 * 0.2, rel=0.2)
        assert (weight * weight.grad).sum() < 0, "downhill"


def of(preset: str) -> tuple[Mvtop, optimiser.Optimizer]:
    model = Mvtop(config.preset(preset, classes_of(ball())))
    return model, optimiser.Optimizer(model)


def test_each_weight_that_is_trained_is_in_one_group():
    for preset in ("lite", "tiny"):
        model, both = of(preset)
        listed = [id(p) for group in both.param_groups for p in group["params"]]
        trained = [id(p) for p in model.parameters() if p.requires_grad]
        assert sorted(listed) == sorted(trained)
        assert ("muon" in both.parts) == (preset == "lite")


def test_results_of_a_lite_network_are_not_taken_for_matrices():
    model, both = of("lite")
    by_muon = {id(p) for group in both.parts["muon"].param_groups for p in group["params"]}
    results = [model.features.coordinates.weight, *(
        p for p in model.features.detector.parameters() if p.ndim > 1 and p.shape[0] < 10
    )]  # fmt: skip
    assert len(results) >= 3
    assert not by_muon & {id(p) for p in results}
    assert all(min(p.shape[0], p.shape[1]) > 1 for p in model.parameters() if id(p) in by_muon)


def test_it_goes_on_where_it_was_stopped():
    def stepped(both, model, count, start=0):
        for n in range(start, start + count):
            torch.manual_seed(n)
            for p in model.parameters():
                if p.requires_grad:
                    p.grad = torch.randn_like(p) * 1e-3
            both.step()

    torch.manual_seed(1)
    model, both = of("lite")
    stepped(both, model, 2)
    kept = copy.deepcopy(both.state_dict())
    weights = {k: x.clone() for k, x in model.state_dict().items()}
    stepped(both, model, 1, start=2)
    again, other = of("lite")
    again.load_state_dict(weights)
    other.load_state_dict(kept)
    stepped(other, again, 1, start=2)
    for name, x in model.state_dict().items():
        assert np.allclose(again.state_dict()[name], x, atol=1e-6), name


def test_boxes_far_off_do_not_shorten_the_step_of_coordinates(tmp_path):
    state = TrainingState(tmp_path, config.preset("lite", classes_of(ball())), "cpu")
    boxes, coordinates = (
        [p for p in part if p.requires_grad] for part in state.model.features.apart()
    )
    loss = sum(1e3 * p.sum() for p in boxes) + sum(p.sum() for p in coordinates)
    before = descend(state, loss, 1e-3, 2.0)
    assert before > 1e3
    for part in (boxes, coordinates):
        assert torch.cat([p.grad.flatten() for p in part]).norm().item() == pytest.approx(2, 0.01)
    trained = {id(p) for p in state.model.parameters() if p.requires_grad}
    assert {id(p) for p in boxes + coordinates} == trained
