"""What ours is compared with: canonical views, late fusion, voting."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
import torch
from conftest import MVBALL, random_pose, random_views

from mvtop_train.data import bop, mvball, objects
from mvtop_train.data.bank import Bank
from mvtop_train.data.boxes import amodal_boxes
from mvtop_train.data.views import ViewMaker, collate
from mvtop_train.errors import UserError
from mvtop_train.evaluation import reliability
from mvtop_train.network import config
from mvtop_train.network.model import Mvtop, decoder_boxes
from mvtop_train.network.voting import rotation_bins
from mvtop_train.study import baselines, canonical, variants
from mvtop_train.study.baselines import late_fusion, vote
from mvtop_train.study.paper import PAPER
from mvtop_train.training.checkpoint import TrainingState, load_weights

POINTS = mvball.bounding_points(100)
K = np.stack([canonical.K] * 2)
NETWORK = config.preset("tiny", MVBALL, closeup=canonical.SIZE, closeup_strides=(16, 32))


def two_cameras():
    """Poses of one object in two cameras that see it from directions 90 degrees apart."""
    rng = np.random.default_rng(4)
    ref_from_obj = random_pose(rng, [0.02, -0.01, 0.7])
    ref_from_cam = np.stack([np.eye(4), np.eye(4)])
    ref_from_cam[1] = [[0, 0, -1, 0.7], [0, 1, 0, 0], [1, 0, 0, 0.7], [0, 0, 0, 1]]
    return ref_from_obj, ref_from_cam, np.linalg.inv(ref_from_cam) @ ref_from_obj


def turned(pose, degrees):
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.deg2rad(degrees) * np.array([0.0, 0, 1]))[0]
    return pose @ turn


def distance(a, b):
    return np.linalg.norm(a[:3, 3] - b[:3, 3])


def test_late_fusion_mends_the_depth_of_each_view():
    truth, ref_from_cam, candidates = two_cameras()
    for view, error in ((0, 0.012), (1, -0.009)):  # along the line of sight: hardly seen there
        candidates[view, 2, 3] += error
    fused, views = late_fusion(candidates, ref_from_cam, K, POINTS)
    assert views == 2
    assert distance(fused, truth) < 0.003


def test_late_fusion_of_candidates_that_disagree_is_the_references_own():
    _, ref_from_cam, candidates = two_cameras()
    candidates[1] = turned(candidates[1], 120)
    fused, views = late_fusion(candidates, ref_from_cam, K, POINTS)
    assert views == 1
    np.testing.assert_array_equal(fused, candidates[0])


@pytest.mark.parametrize("common", [(0, 0), (3, 1), (2, 3)])
def test_the_vote_finds_the_pose_that_both_views_propose(common):
    truth, ref_from_cam, right = two_cameras()
    # Turns that no other view proposes: 40, 80, 120 and 20, 60, 100 degrees away from the truth.
    wrong = [[turned(right[v], d + 40 * i) for i in range(3)] for v, d in ((0, 40), (1, 20))]
    hypotheses = [list(w) for w in wrong]
    for view in range(2):
        hypotheses[view].insert(common[view], right[view])
    won = vote(np.array(hypotheses), ref_from_cam, POINTS)
    np.testing.assert_allclose(won, truth, atol=1e-9)


def test_a_vote_without_support_is_the_references_best():
    _, ref_from_cam, right = two_cameras()
    hypotheses = np.array([[right[0]], [turned(right[1], 90)]])
    np.testing.assert_allclose(vote(hypotheses, ref_from_cam, POINTS), right[0], atol=1e-12)


def test_rotation_bins_are_rotations_and_leave_no_hole():
    bins = rotation_bins(512)
    np.testing.assert_allclose(bins @ bins.swapaxes(1, 2), np.broadcast_to(np.eye(3), bins.shape),
                               atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(bins), 1)
    rng = np.random.default_rng(0)
    for _ in range(200):
        trace = np.einsum("nij,ij->n", bins, random_pose(rng)[:3, :3]).max()
        assert np.rad2deg(np.arccos(np.clip((trace - 1) / 2, -1, 1))) < 32


def test_the_hypothesis_loss_is_least_at_the_truth():
    bins = torch.from_numpy(rotation_bins(16)).float()
    truth = torch.eye(4)[None, None].clone()
    truth[..., :3, :3] = bins[5]

    def loss(bin_number, rotations, shift):
        logits = torch.full((1, 1, 16), -5.0)
        logits[..., bin_number] = 5.0
        translation = torch.full((1, 1, 3), shift)
        return baselines.hypothesis_loss([(logits, rotations, translation, bins)], truth).item()

    best = loss(5, bins[None, None], 0.0)
    assert best < 0.01
    assert loss(6, bins[None, None], 0.0) > best + 1
    assert loss(5, bins.roll(1, 0)[None, None], 0.0) > best + 0.1
    assert loss(5, bins[None, None], 0.1) > best + 0.5


def test_a_canonical_view_shows_points_where_its_camera_says(tmp_path):
    k = np.array([[600.0, 0, 315], [0, 600, 244], [0, 0, 1]])
    cam_from_obj = random_pose(np.random.default_rng(1), [0.1, -0.06, 0.8])
    center = (k @ cam_from_obj[:3, 3] / cam_from_obj[2, 3])[:2]
    rgb = np.zeros((480, 640, 3), np.uint8)
    dot = np.round(center + [12, -7]).astype(int)  # a pixel near the object's center
    rgb[dot[1], dot[0]] = 255
    rgb = cv2.GaussianBlur(rgb, (0, 0), 2)
    rgb = (rgb * (250 / rgb.max())).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "image.png"), rgb)
    ball = bop.Instance(1, cam_from_obj, box=np.array([*(center - 40), *(center + 40)]))
    image = bop.Image(0, tmp_path / "image.png", k, np.eye(4), [ball])
    for augment in (False, True):
        rng = np.random.default_rng(7)
        view = ViewMaker(canonical.Canonical(), NETWORK, (objects.ball(),), augment).make_view(
            image, rng
        )
        crop, new_from_old = view["image"], view["cam_from_world"]  # the old one is the world's
        ray = new_from_old[:3, :3] @ np.linalg.inv(k) @ [*dot, 1.0]
        expected = (canonical.K @ ray / ray[2])[:2]
        row, column = np.unravel_index(crop.mean(-1).argmax(), crop.shape[:2])
        assert np.abs([column, row] - expected).max() < 1.5
        middle = canonical.K @ (new_from_old @ cam_from_obj)[:3, 3]
        assert np.linalg.norm(middle[:2] / middle[2] - 79.5) < 8  # jitter of the box


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    monkeypatch.setattr(variants, "IMAGES", 8)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Weights of a network, and features of three scenes of four images."""
    root, rng = tmp_path_factory.mktemp("study"), np.random.default_rng(0)
    run = TrainingState(root / "run", NETWORK, "cpu")
    run.save()
    k = np.array([[300.0, 0, 119.5], [0, 300, 119.5], [0, 0, 1]])
    scenes = []
    for _ in range(3):
        world_from_obj, scene = random_pose(rng), []
        for n in range(4):
            path = root / f"{len(scenes)}-{n}.png"
            cv2.imwrite(str(path), rng.integers(0, 256, (240, 240, 3), np.uint8))
            cam_from_obj = random_pose(rng, [0, 0, 0.7])
            ball = bop.Instance(
                1, cam_from_obj, amodal_boxes(POINTS, k, cam_from_obj),
                info={"hemisphere": ["green", "red"][n % 2]},
            )  # fmt: skip
            cam_from_world = cam_from_obj @ np.linalg.inv(world_from_obj)
            scene.append(bop.Image(n, path, k, cam_from_world, [ball]))
        scenes.append(scene)
    maker = ViewMaker(canonical.Canonical(), NETWORK, (objects.ball(),))
    bank = Bank(root / "bank", scenes, maker, run.average.features, 1, 0, workers=0)
    return root / "run" / "weights.pt", bank


@pytest.mark.parametrize("name", variants.VARIANTS)
def test_every_variant_trains_and_is_tested(trained, tmp_path, name):
    weights, bank = trained
    variant = variants.VARIANTS[name]
    network = variants.config_of(variant, NETWORK, (16, 32))
    budget = variants.Budget(steps=2)
    state = variants.fit(variant, bank, network, tmp_path / name, weights, budget, seed=0)
    results = variants.test(state.average, variant, bank)
    wanted = {"two_views"} if variant.views == 2 else {"one_view"}
    assert wanted <= set(results)
    for result in results.values():
        assert result["pairs"] == 3
        assert 0 <= result["rot_mean_deg"] <= 180 and np.isfinite(result["add_mean_m"])


def test_a_variant_that_was_stopped_goes_on(trained, tmp_path, monkeypatch):
    weights, bank = trained
    monkeypatch.setattr(variants, "learning_rate", lambda *_: 1e-3)  # else it depends on `steps`
    monkeypatch.setattr(variants, "LOOKED_AT", 2)
    variant = variants.VARIANTS["baseline"]
    network = variants.config_of(variant, NETWORK, (16, 32))
    fitted = {}
    for name, stops in (("through", (4,)), ("stopped", (2, 4))):
        for steps in stops:
            run = variants.fit(
                variant, bank, network, tmp_path / name, weights, variants.Budget(steps), seed=0,
                look=lambda network: variants.test(network, variant, bank),
            ).average  # fmt: skip
        fitted[name] = run.decoder.state_dict()
        assert load_weights(tmp_path / name / "last.pt")[2] == 4
        curve = [json.loads(line) for line in (tmp_path / name / "curve.jsonl").open()]
        assert [point["step"] for point in curve] == [2, 4]
        assert curve[1]["two_views"] == variants.test(run, variant, bank)["two_views"]
        assert curve[0]["two_views"] != curve[1]["two_views"]
    for name, weight in fitted["through"].items():
        torch.testing.assert_close(fitted["stopped"][name], weight)
    fresh = variants.fit(
        variant, bank, network, tmp_path / "two", weights, variants.Budget(2), seed=0
    ).average
    assert not torch.equal(fresh.decoder.query[0].weight, fitted["through"]["query.0.weight"])


def test_a_variant_without_lines_of_sight_has_none(trained):
    """Nor does its pose change with where the cameras look."""
    weights, bank = trained
    variant = variants.VARIANTS["single"]
    network = variants.config_of(variant, NETWORK, (16, 32))
    torch.manual_seed(0)
    model = Mvtop(network).eval()
    batch = collate([[bank.row(0)], [bank.row(1)]])
    views = variants.given(batch, variant, network)
    expected = variants.outputs_of(model, views)[-1]
    views.k = views.k * torch.tensor([[2.0], [3.0], [1.0]])
    for a, b in zip(expected, variants.outputs_of(model, views)[-1], strict=True):
        torch.testing.assert_close(a, b)
    seeing = dataclasses.replace(variant, los_encoding="direction")
    views = variants.given(batch, seeing, network)
    other = variants.outputs_of(model, views)[-1]
    assert not torch.allclose(expected[0], other[0])


@pytest.mark.parametrize("geometry", ["image", "rays"])
def test_dummy_queries_are_seen_and_say_nothing(trained, geometry):
    weights, bank = trained
    variant = dataclasses.replace(variants.VARIANTS["baseline"], geometry=geometry, queries=3)
    network = variants.config_of(variant, NETWORK, (16, 32))
    torch.manual_seed(0)
    model = Mvtop(network).eval()
    batch = collate([[bank.row(0), bank.row(1)]])
    outputs = []
    for queries in (1, 3):
        views = variants.given(batch, dataclasses.replace(variant, queries=queries), network)
        assert views.boxes.shape == (1, 2, queries, 4)
        boxes = decoder_boxes(views, canonical.SIZE, canonical.SIZE)
        torch.testing.assert_close(boxes.centers[0, 0, 1:], torch.full((queries - 1, 2), -1.0))
        torch.testing.assert_close(boxes.half_sizes[0, 0, 1:], torch.full((queries - 1, 2), -0.5))
        outputs.append(variants.outputs_of(model, views)[-1])
    assert [part.shape for part in outputs[1]] == [(1, 1, 6), (1, 1, 3), (1, 1, 2)]
    assert not torch.allclose(outputs[0][0], outputs[1][0])


def test_results_are_judged_by_both_bounds(tmp_path):
    row = {"rot_deg": 4.9, "trans_m": 0.0049, "confidence": 0.75, "views": 2}
    rows = [row, row | {"rot_deg": 5.1}, row | {"trans_m": 0.0051}, row | {"confidence": None}]
    path = tmp_path / "results.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    assert reliability.read(path).tolist() == [[0.75, 1], [0.75, 0], [0.75, 0]]
    path.write_text("{}")
    assert reliability.read(path).shape == (0, 2)  # nothing was found
    path.write_text("poses")
    with pytest.raises(UserError, match="eval samples --out"):
        reliability.read(path)


def test_the_paper_s_network_builds_and_trains():
    c = dataclasses.replace(PAPER, classes=MVBALL, width=160, height=128)
    assert (c.encoder_layers, c.decoder_layers, c.heads, c.d_model) == (5, 5, 16, 256)
    torch.manual_seed(0)
    model = Mvtop(c)
    poses = model(random_views(c, 2)).poses
    assert [rotation.shape for rotation, *_ in poses] == [(1, 1, 6)] * 5
    sum(part.square().sum() for layer in poses for part in layer).backward()
    for name, parameter in model.named_parameters():
        if name.startswith(("features.encoder", "decoder")):
            assert parameter.grad is not None, name
