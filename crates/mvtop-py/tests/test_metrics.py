"""Errors of poses and statistics of them as functions of arrays."""

import numpy as np
import pytest
from poses import turn

import mvtop

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
EYE = np.eye(4)


def test_errors_of_poses_by_hand(rng):
    quarter = EYE.copy()
    quarter[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    moved = EYE.copy()
    moved[:3, 3] = [0.3, 0, 0.4]
    half = quarter @ quarter
    both = np.stack([quarter, moved])
    np.testing.assert_allclose(mvtop.metrics.rotation_error_deg(EYE, both), [90, 0], atol=1e-6)
    np.testing.assert_allclose(mvtop.metrics.translation_error(both, EYE), [0, 0.5], atol=1e-12)
    # A quarter turn about z moves (1, 0, 0) by sqrt(2) and leaves (0, 0, 1) where it is.
    points = [[1, 0, 0], [0, 0, 1]]
    surface = mvtop.metrics.Surface(points)
    np.testing.assert_allclose(surface.add(EYE, both), [np.sqrt(0.5), 0.5])
    np.testing.assert_allclose(surface.mssd(EYE, both), [np.sqrt(2), 0.5])
    np.testing.assert_allclose(surface.add_or_add_s(EYE, both, False), surface.add(EYE, both))
    about_z = mvtop.metrics.Symmetries(continuous=[([0, 0, 1], [0, 0, 0])])
    assert len(about_z) == 315  # ceil(pi / 0.01)
    assert mvtop.metrics.rotation_error_deg(EYE, quarter, about_z) < 0.6
    np.testing.assert_allclose(mvtop.metrics.Surface([[1, 0, 0], [-1, 0, 0]]).add_s(EYE, half), 0)
    # A pixel is 2 mm wide at 1 m: 10 mm to the side are 5 px.
    beside = EYE.copy()
    beside[0, 3] = 0.01
    camera = mvtop.Camera(K, (640, 480))
    ahead = EYE.copy()
    ahead[2, 3] = 1
    np.testing.assert_allclose(
        mvtop.metrics.Surface([[0, 0, 0]]).mspd(ahead, beside @ ahead, camera), 5
    )
    assert mvtop.metrics.rotation_error_deg(turn(rng, 2, 3), np.eye(3)).shape == (2, 3)
    with pytest.raises(ValueError, match=r"estimate: expected numbers of shape \(.*4, 4\)"):
        mvtop.metrics.Surface([[1, 0, 0]]).add(EYE, np.eye(3))  # no pose: nothing says where


def test_depth_images_and_what_differs_between_them():
    # A square of 0.2 m at 1 m: 100 px wide, around the principal point.
    corners = [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]
    square = mvtop.metrics.Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    camera = mvtop.Camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], (640, 480))
    ahead = EYE.copy()
    ahead[2, 3] = 1
    truth = square.depth(ahead, camera)
    assert truth.shape == (480, 640) and truth.dtype == np.float32
    assert (truth > 0).sum() == 100 * 100 and truth[240, 320] == 1
    # Moved by a quarter of its width, it shares three of five quarters with where it was.
    ahead[0, 3] = 0.05
    estimate = square.depth(ahead, camera)
    (off,) = mvtop.metrics.vsd(
        estimate, truth, np.zeros_like(truth), camera, delta=0.015, taus=[0.1]
    )
    assert off == pytest.approx(2 / 5)


def test_recalls_by_hand():
    errors = [0.01, 0.03, 0.05, np.inf]
    assert mvtop.metrics.recall(errors, 0.05) == 0.5
    assert mvtop.metrics.average_recall(errors, [0.02, 0.1]) == 0.5
    assert mvtop.metrics.auc_exact(errors, 0.1) == pytest.approx((0.9 + 0.7 + 0.5) / 4)
    assert mvtop.metrics.recall([], 1) is None


ERRORS = np.array([0.01, 0.03])


@pytest.mark.parametrize(
    "errors, sentence",
    [
        ([0.1, np.nan], "errors: expected 0 or more, infinity for what was not found, got NaN"),
        ([0.1, -0.1], "errors: expected 0 or more, infinity for what was not found, got -0.1"),
        ([-np.inf], "errors: expected 0 or more"),
        (ERRORS + 1j, "errors: expected numbers of shape (any), got complex128"),
        (ERRORS.astype("timedelta64[s]"), "got timedelta64"),
        (np.ma.masked_array(ERRORS, [True, False]), "got a masked array of float64"),
        (ERRORS[None], "errors: expected numbers of shape (any), got shape [1, 2]"),
    ],
)
def test_errors_that_are_none_are_refused_by_every_summary(errors, sentence):
    metrics = mvtop.metrics
    summaries = [metrics.recall, metrics.auc_exact, metrics.auc_posecnn, metrics.auc_poet]
    summaries.append(lambda errors, limit: metrics.average_recall(errors, [limit]))
    for summary in summaries:
        with pytest.raises(ValueError) as refused:
            summary(errors, 0.1)
        assert sentence in str(refused.value)
        for limit in (0, -1, np.nan, np.inf):
            with pytest.raises(ValueError, match="expected a number above 0"):
                summary(ERRORS, limit)


def test_vsd_refuses_tolerances_and_diameters_that_are_none():
    depth, camera = np.ones((480, 640)), mvtop.Camera(K, (640, 480))
    for wrong in ({"diameter": -1.0}, {"taus": [0.0]}, {"delta": -1.0}, {"delta": np.nan}):
        with pytest.raises(ValueError, match="delta of 0 or more, taus and diameter above 0"):
            mvtop.metrics.vsd(depth, depth, depth, camera, **{"delta": 0.015, **wrong})


def test_statistics_by_hand():
    scores, labels = np.array([1.0, 3.0, 2.0, 3.0]), np.array([False, False, True, True])
    # Pairs of one with and one without the label: in order, not, in order, equal.
    assert mvtop.uncertainty.auroc(scores, labels) == 2.5 / 4
    assert mvtop.uncertainty.auroc(scores, labels.astype(float)) == 2.5 / 4
    assert mvtop.uncertainty.auroc(scores, [True] * 4) is None
    curve = mvtop.uncertainty.roc_curve(scores, labels)
    np.testing.assert_array_equal(curve, [[0, 0], [0.5, 0.5], [0.5, 1], [1, 1]])
    assert mvtop.uncertainty.correlation([1, 2, 3], [4, 2, 0]) == pytest.approx(-1)
    assert mvtop.uncertainty.correlation([1, 1], [2, 3]) is None
    bins = mvtop.uncertainty.calibration([3, 1, 2, 4], [30, 10, 30, 60], bins=2)
    np.testing.assert_array_equal(bins, [[1.5, 20], [3.5, 45]])
    assert mvtop.uncertainty.calibration(np.arange(9), np.arange(9)).shape == (5, 2)
    with pytest.raises(ValueError, match="labels: expected 4 numbers, as many as of scores, got 3"):
        mvtop.uncertainty.auroc(scores, labels[1:])


@pytest.mark.parametrize("statistic", [mvtop.uncertainty.auroc, mvtop.uncertainty.roc_curve])
@pytest.mark.parametrize("label, shown", [(-1, "-1"), (0.9, "0.9"), (np.nan, "NaN")])
def test_labels_that_are_neither_true_nor_false_are_refused(statistic, label, shown):
    with pytest.raises(ValueError, match=f"expected bools, or 0 and 1, got {shown} at index 2; "):
        statistic([4, 1, 3, 2], [1, 0, label, 2])
