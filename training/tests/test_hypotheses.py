"""Several poses of an object: which one learns, which one is given, and what is exported."""

import dataclasses

import numpy as np
import onnxruntime
import pytest
import torch
from conftest import random_views
from test_export import decoder_inputs, run

from mvtop_train.export import bundle
from mvtop_train.network import losses, pose, symmetry
from mvtop_train.network.config import ObjectClass
from mvtop_train.network.heads import Hypotheses
from mvtop_train.network.model import Mvtop
from mvtop_train.training import checkpoint

BALL = symmetry.of((ObjectClass(1, "ball", 0.1),))


def about_z(degrees):
    """Poses [N, 4, 4] turned by these angles, a metre away."""
    angle = torch.deg2rad(torch.as_tensor(degrees, dtype=torch.float32))
    poses = torch.eye(4).repeat(len(angle), 1, 1)
    poses[:, 0, 0] = poses[:, 1, 1] = angle.cos()
    poses[:, 1, 0], poses[:, 0, 1], poses[:, 2, 3] = angle.sin(), -angle.sin(), 1
    return poses


def hypotheses_at(degrees, score):
    """Of one object."""
    poses = about_z(degrees)
    six = torch.cat([poses[:, :3, 0], poses[:, :3, 1]], -1)
    sigma = torch.tensor([10.0, 0.01]).expand(len(poses), 2)
    parts = six, poses[:, :3, 3], sigma, torch.tensor(score)
    return Hypotheses(*(x[None, None].clone().requires_grad_() for x in parts))


def batch_of(truth):
    return {
        "cam_from_obj": truth[:, None],
        "class_index": torch.zeros(len(truth), 1, dtype=torch.long),
    }


def several(tiny, count):
    torch.manual_seed(3)
    return Mvtop(dataclasses.replace(tiny.config, hypotheses=count)).eval()


def test_the_nearest_learns_the_pose_and_the_scores_learn_which_it_is():
    given = hypotheses_at([0.0, 60.0, 180.0], [2.0, 0.0, -1.0])
    terms = losses.hypotheses_loss([given], batch_of(about_z([50.0])), BALL, losses.WEIGHTS)
    off, third = np.deg2rad([50, 10, 130]), losses.SHARED / 3
    expected = third * off.sum() + (1 - losses.SHARED) * off[1]
    assert terms["rotation"].item() == pytest.approx(expected, abs=1e-4)
    assert terms["score"].item() == pytest.approx(np.log(np.exp([2.0, 0.0, -1.0]).sum()), abs=1e-5)
    pull = torch.autograd.grad(terms["rotation"], given.rotation_6d)[0][0, 0].norm(dim=-1)
    assert pull[1] > 10 * pull[0] and pull[1] > 10 * pull[2] > 0
    best = given.best()
    torch.testing.assert_close(best[0], given.rotation_6d[:, :, 0])
    assert [x.shape for x in best] == [(1, 1, 6), (1, 1, 3), (1, 1, 2)]


def test_what_is_one_of_two_is_learnt_as_two():
    """Free poses in place of a network: one in three is turned by 40 degrees, the others by -80."""
    degrees = torch.tensor([40.0, -80.0, -80.0]).repeat(20)
    truth, free = batch_of(about_z(degrees)), hypotheses_at([-5.0, 5.0], [0.0, 0.0])
    adam = torch.optim.Adam(free, lr=0.03)
    for _ in range(300):
        layer = Hypotheses(*(x.expand(len(degrees), *x.shape[1:]) for x in free))
        terms = losses.hypotheses_loss([layer], truth, BALL, losses.WEIGHTS)
        adam.zero_grad()
        sum(losses.WEIGHTS[name] * term for name, term in terms.items()).backward()
        adam.step()
    rotation = pose.rotation_from_6d(free.rotation_6d[0, 0])
    found = torch.rad2deg(torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0])).tolist()
    assert found == pytest.approx([-80, 40], abs=8)
    assert free.score.softmax(-1).flatten().tolist() == pytest.approx([2 / 3, 1 / 3], abs=0.03)


def test_a_network_of_one_pose_grows_more(tiny):
    grown = several(tiny, 4)
    average = {checkpoint.AVERAGE + name: x for name, x in tiny.state_dict().items()}
    checkpoint.grow_hypotheses(average, grown)
    grown.load_state_dict({name.removeprefix(checkpoint.AVERAGE): x for name, x in average.items()})
    views = random_views(tiny.config, 2)
    with torch.no_grad():
        one, all_of_them = tiny(views).poses, grown(views).hypotheses
    for before, after in zip(one, all_of_them, strict=True):
        for x, y in zip(before, after, strict=False):
            torch.testing.assert_close(y[:, :, 0], x, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("queries", [1, 3])
def test_the_exported_decoder_gives_all_and_the_best(closeups, tmp_path, queries):
    model = several(closeups, 3)
    bundle.write_bundle(model, tmp_path, {}, portable=True)
    inputs = decoder_inputs(model.config, 2, queries)
    session = onnxruntime.InferenceSession(tmp_path / "decoder.onnx")
    names = [output.name for output in session.get_outputs()]
    got = dict(zip(names, run(session, inputs), strict=True))
    with torch.no_grad():
        expected = bundle.ExportedDecoder(model)(**inputs)
    for name, values in zip(names, expected, strict=True):
        np.testing.assert_allclose(got[name], values.numpy(), atol=2e-4, rtol=1e-3)
    best = got["hypotheses_score"].argmax(-1)
    for q, k in enumerate(best):
        np.testing.assert_array_equal(got["rotation_6d"][q], got["hypotheses_rotation_6d"][q, k])
        np.testing.assert_array_equal(got["sigma"][q], got["hypotheses_sigma"][q, k])
