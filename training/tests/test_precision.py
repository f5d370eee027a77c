"""Which precision a network is trained in."""

import pytest
import torch

from mvtop_train.network import precision


@pytest.fixture(autouse=True)
def measured_anew():
    precision._fastest.cache_clear()
    yield
    precision._fastest.cache_clear()


def product_under(**how) -> torch.dtype:
    with precision.autocast("cpu", **how):
        return (torch.ones(2, 3) @ torch.ones(3, 2)).dtype


def test_what_is_named_is_taken():
    assert product_under(precision="fp32") == torch.float32
    assert product_under(precision="bf16") == torch.bfloat16


@pytest.mark.parametrize(("bf16", "chosen"), [(0.5, torch.bfloat16), (0.9, torch.float32)])
def test_bf16_is_chosen_where_it_gains_enough(monkeypatch, bf16, chosen):
    seconds = {torch.float32: 1.0, torch.bfloat16: bf16}
    monkeypatch.setattr(precision, "_product", seconds.get)
    assert product_under() == chosen


def test_gpus_are_not_measured(monkeypatch):
    monkeypatch.setattr(precision, "_product", None)
    assert precision._fastest("cuda") == "bf16"


def test_a_product_takes_time():
    assert 0 < precision._product(torch.float32) < 1
