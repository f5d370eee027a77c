"""Cameras, rays and rotations as functions of arrays."""

import copy
import pickle

import cv2
import numpy as np
import pytest
from poses import pose

import mvtop

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
BROWN = [0.09, -0.22, 0.001, -0.002, 0.05]
KANNALA = [-0.006, 0.016, -0.024, 0.0155]
EYE = np.eye(4)
SKEW = np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, 0]])
MIRRORED = np.diag([1, 1, -1, 1.0])
MILLIMETRES = np.stack([EYE, EYE])
MILLIMETRES[1, 0, 3] = 800


def test_pinhole_projects_by_hand():
    camera = mvtop.Camera(K, (640, 480))
    # 500 * 0.1 / 2 + 320 and 510 * -0.2 / 2 + 240.
    assert camera.project([0.1, -0.2, 2.0]).tolist() == [345.0, 189.0]
    assert np.isnan(camera.project([0.1, -0.2, -2.0])).all()
    ray = camera.unproject([345.0, 189.0])
    np.testing.assert_allclose(ray, np.array([0.05, -0.1, 1]) / np.sqrt(1.0125), atol=1e-12)


@pytest.mark.parametrize("model, distortion", [("pinhole", BROWN), ("fisheye", KANNALA)])
def test_lenses_project_like_opencv_and_back(model, distortion, rng):
    camera = mvtop.Camera(K, (640, 480), distortion=distortion, model=model)
    points = rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 1.5], size=(5, 7, 3))
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    if model == "fisheye":
        zero = np.zeros(3)
        expected, _ = project(points.reshape(-1, 1, 3), zero, zero, K, np.array(distortion))
    else:
        expected, _ = project(
            points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, np.array(distortion)
        )
    pixels = camera.project(points)
    np.testing.assert_allclose(pixels, expected.reshape(5, 7, 2), atol=1e-9)
    directions = points / np.linalg.norm(points, axis=-1, keepdims=True)
    np.testing.assert_allclose(camera.unproject(pixels), directions, atol=1e-9)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_distortion_is_taken_in_the_shapes_that_opencv_returns(count):
    params = np.linspace(0.01, 0.02, count)
    expected = mvtop.Camera(K, (640, 480), distortion=params).distortion
    np.testing.assert_array_equal(expected[:count], params)
    for shape in [(1, count), (count, 1)]:
        camera = mvtop.Camera(K, (640, 480), distortion=params.reshape(shape))
        np.testing.assert_array_equal(camera.distortion, expected)
    poses = np.stack([EYE] * 4)
    poses[:, 0, 3] = np.arange(4)
    for shape in [(1, count), (count, 1), (4, 1, count), (4, count, 1)]:
        each = np.broadcast_to(params, (4, count)) if len(shape) == 3 else params
        rig = mvtop.Rig.from_arrays(K, poses, (640, 480), distortion=each.reshape(shape))
        np.testing.assert_array_equal(rig.cameras[3].distortion, expected)


def test_rigs_are_imported(tmp_path):
    camera = (
        "camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0.1, 0, 0, 0]\n  "
        "intrinsics: [500, 500, 320, 240]\n  resolution: [640, 480]\n"
    )
    chain = "  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    file = tmp_path / "chain.yaml"
    file.write_text(f"cam0:\n  {camera}cam1:\n  {camera}{chain}")
    rig, notes = mvtop.Rig.import_file([file])
    assert rig.cameras[1].world_from_cam[:3, 3].tolist() == [0.1, 0, 0]
    assert any("world frame" in note for note in notes)
    assert mvtop.Rig.import_file(str(file))[0] == mvtop.Rig.import_file(file)[0] == rig
    with pytest.raises(ValueError, match="expected"):
        mvtop.Rig.import_file([file], format="bop")
    with pytest.raises(ValueError, match="not known"):
        mvtop.Rig.import_file([file], unit="furlong")
    with pytest.raises(ValueError, match="trust_unit"):
        mvtop.Rig.import_file([file], scale=1e-6)
    near, _ = mvtop.Rig.import_file([file], scale=1e-6, trust_unit=True)
    assert near.cameras[1].world_from_cam[0, 3] == pytest.approx(1e-7)
    with pytest.raises(FileNotFoundError):
        mvtop.Rig.import_file([tmp_path / "none.yaml"])


def test_cameras_give_back_what_they_were_made_from(rng):
    world_from_cam = pose(rng)
    camera = mvtop.Camera(
        K, (640, 480), distortion=KANNALA, model="fisheye", world_from_cam=world_from_cam, id="left"
    )
    assert (camera.id, camera.size, camera.model) == ("left", (640, 480), "fisheye")
    assert mvtop.Camera(K, np.array([640.0, 480.0])).size == (640, 480)
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(camera.distortion, KANNALA)
    np.testing.assert_allclose(camera.world_from_cam, world_from_cam, atol=1e-12)


def test_rigs_from_arrays_from_cameras_and_from_text_are_the_same(rng):
    poses = pose(rng, 3)
    ids = ["a", "b", "c"]
    by_arrays = mvtop.Rig.from_arrays(
        K, poses, (640, 480), distortion=BROWN, ids=ids, reference="b"
    )
    cameras = [
        mvtop.Camera(K, (640, 480), distortion=BROWN, world_from_cam=p, id=i)
        for p, i in zip(poses, ids, strict=True)
    ]
    assert mvtop.Rig(cameras, "b").to_json() == by_arrays.to_json()
    assert mvtop.Rig.from_json(by_arrays.to_json()).to_json() == by_arrays.to_json()
    assert (len(by_arrays), by_arrays.reference) == (3, "b")
    for camera, expected in zip(by_arrays.cameras, poses, strict=True):
        np.testing.assert_allclose(camera.world_from_cam, expected, atol=1e-12)
    each = mvtop.Rig.from_arrays(
        np.stack([K] * 3), poses, [(640, 480)] * 3, distortion=[BROWN] * 3, ids=ids, reference="b"
    )
    assert each.to_json() == by_arrays.to_json()
    assert [camera.id for camera in mvtop.Rig.from_arrays(K, poses, (640, 480)).cameras] == [
        "cam0",
        "cam1",
        "cam2",
    ]


def test_coefficients_of_zero_are_no_distortion():
    plain = mvtop.Camera(K, (640, 480))
    zeros = mvtop.Camera(K, (640, 480), distortion=np.zeros(5))
    assert zeros.distortion.size == 0
    triangle = mvtop.metrics.Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]])
    ahead = np.eye(4)
    ahead[:3, 3] = -0.5, -0.4, 1
    depth = triangle.depth(ahead, zeros)
    assert depth.any()
    np.testing.assert_array_equal(depth, triangle.depth(ahead, plain))


@pytest.mark.parametrize("model, distortion", [("pinhole", BROWN), ("fisheye", KANNALA)])
def test_pickled_and_copied_cameras_are_the_same(model, distortion, rng):
    camera = mvtop.Camera(
        K, (640, 480), distortion=distortion, model=model, world_from_cam=pose(rng), id="left",
        max_angle_deg=50.5,
    )  # fmt: skip
    for again in (pickle.loads(pickle.dumps(camera)), copy.deepcopy(camera)):
        assert (again.id, again.size, again.model) == (camera.id, camera.size, camera.model)
        assert again.max_angle_deg == 50.5
        np.testing.assert_array_equal(again.K, camera.K)
        np.testing.assert_array_equal(again.distortion, camera.distortion)
        np.testing.assert_allclose(again.world_from_cam, camera.world_from_cam, atol=1e-12)


def test_pickled_cameras_are_equal_wherever_they_look():
    rng = np.random.default_rng(5)
    for turned in pose(rng, 300):
        camera = mvtop.Camera(K, (640, 480), world_from_cam=turned)
        assert pickle.loads(pickle.dumps(camera)) == camera


def test_cameras_stand_as_far_apart_as_is_said(tmp_path):
    far = mvtop.Rig.from_arrays(K, MILLIMETRES, (640, 480), trust_unit=True)
    with pytest.raises(ValueError, match="`trust_unit` to true"):
        mvtop.Rig(far.cameras)
    assert mvtop.Rig(far.cameras, trust_unit=True) == far
    far.save(tmp_path / "rig.json")
    assert mvtop.Rig.load(tmp_path / "rig.json") == far == pickle.loads(pickle.dumps(far))
    still = mvtop.Rig.from_arrays(K, [EYE, EYE], (640, 480), trust_unit=True)
    assert len(still) == 2


def test_objects_say_what_they_are():
    camera = mvtop.Camera(K, (640, 480), id="left")
    assert repr(camera) == 'Camera("left", 640x480 px, pinhole)'
    assert repr(mvtop.Rig([camera])) == "Rig(left; reference left)"
    assert repr(mvtop.metrics.Surface(np.zeros((7, 3)))) == "Surface(7 points)"
    assert repr(mvtop.metrics.Symmetries()) == "Symmetries(1 motions)"
    triangle = mvtop.metrics.Mesh(np.eye(3), [[0, 1, 2]])
    assert repr(triangle) == "Mesh(3 vertices, 1 triangles)"


def test_axes_of_an_image_may_be_askew():
    camera = mvtop.Camera(K + SKEW * 3, (640, 480))
    np.testing.assert_array_equal(camera.K, K + SKEW * 3)
    point = np.array([0.1, -0.2, 1.0])
    pixel = camera.project(point)
    np.testing.assert_allclose(pixel, (camera.K @ point)[:2], atol=1e-12)
    np.testing.assert_allclose(camera.unproject(pixel), point / np.linalg.norm(point), atol=1e-12)
    assert pickle.loads(pickle.dumps(camera)) == camera != mvtop.Camera(K, (640, 480))

    bent = (-0.006, 0.016, -0.024, 0.0155)
    fisheye = mvtop.Camera(K + SKEW * 3, (640, 480), model="fisheye", distortion=bent)
    still = np.zeros(3)
    by_opencv, _ = cv2.fisheye.projectPoints(
        point[None, None], still, still, K, np.array(bent), alpha=3 / K[0, 0]
    )
    np.testing.assert_allclose(fisheye.project(point), by_opencv[0, 0], atol=1e-9)


@pytest.mark.parametrize(
    "mistake, sentence",
    [
        (lambda: mvtop.Camera(K.T, (640, 480)), "K must be"),
        (lambda: mvtop.Camera(K[:, [0, 2, 1]], (640, 480)), "K must be"),
        (lambda: mvtop.Camera(K + SKEW * 70, (640, 480)), "`skew`"),
        (lambda: mvtop.Camera(K[:2], (640, 480)), "K: expected numbers of shape (3, 3), got"),
        (lambda: mvtop.Camera(K * np.nan, (640, 480)), "K: expected finite numbers, got NaN"),
        (lambda: mvtop.Camera("K", (640, 480)), "K: expected numbers of shape (3, 3), got"),
        (lambda: mvtop.Camera(K, (640, 0)), "`height`"),
        (
            lambda: mvtop.Camera(K, (-640, 480)),
            "`width` must be a whole number of pixels, got -640",
        ),
        (lambda: mvtop.Camera(K, (640, 480.5)), "`height` must be a whole number of pixels"),
        (lambda: mvtop.Camera(K, 640), "size: expected numbers of shape (2)"),
        (lambda: mvtop.uncertainty.calibration([1.0], [1.0], bins=-1), "bins: expected 0 or more"),
        (lambda: mvtop.Camera(K, (640, 480), distortion=[1, 2]), "0, 4, 5, 8, 12 or 14"),
        (lambda: mvtop.Camera(K, (640, 480), model="orthographic"), "model"),
        (lambda: mvtop.Camera(K, (640, 480), world_from_cam=2 * EYE), "last row"),
        (
            lambda: mvtop.Camera(K, (640, 480), world_from_cam=MIRRORED),
            "reflection",
        ),
        (lambda: mvtop.Camera(K, (640, 480)).project([1.0, 2.0]), "points: expected numbers of"),
        (lambda: mvtop.Rig([]), "cameras"),
        (lambda: mvtop.Rig([mvtop.Camera(K, (640, 480))], "top"), "no camera `top`"),
        (lambda: mvtop.Rig.from_arrays(K, MILLIMETRES, (640, 480)), "unit"),
        (lambda: mvtop.Rig.from_arrays([K] * 3, EYE[None], (640, 480)), "K: expected one for"),
        (
            lambda: mvtop.Rig.from_arrays(K, EYE[None], (640, 480), ids=["a", "b"]),
            "ids: expected",
        ),
        (lambda: mvtop.Rig.from_json("{}"), "rig: "),
        (lambda: mvtop.rotation_from_6d([1, 0, 0, 2, 0, 0]), "parallel"),
        (lambda: mvtop.encode_rays([[0, 0, 1]], EYE, "cartesian"), "encoding: expected"),
        (lambda: mvtop.encode_rays([[0, 0, 1]], EYE[:3]), "ref_from_cam: expected"),
        (lambda: mvtop.camera_rays(mvtop.Camera(K, (640, 480)), [0]), "strides"),
        (
            lambda: mvtop.camera_rays(
                mvtop.Camera(K, (640, 480)), [1], net_size=(2**32 - 1, 2**32 - 1)
            ),
            "expected 16777216 cells at most",
        ),
        (
            lambda: mvtop.camera_rays(
                mvtop.Camera(K, (640, 480)), [8], net_size=(100_000, 100_000)
            ),
            "expected 16777216 cells at most, got 156250000",
        ),
        (lambda: mvtop.Camera(K.astype(complex), (640, 480)), "K: expected numbers of shape (3"),
        (lambda: mvtop.Camera(np.ma.masked_array(K), (640, 480)), "got a masked array of float64"),
        (lambda: mvtop.metrics.Surface([[0, 0, 0]]).add(2 * EYE, EYE), "last row"),
        (lambda: mvtop.metrics.Surface(np.zeros((0, 3))), "expected at least one point"),
        (
            lambda: mvtop.metrics.rotation_error_deg(np.stack([EYE] * 2), np.stack([EYE] * 3)),
            "as many true poses",
        ),
    ],
)
def test_mistakes_are_value_errors(mistake, sentence):
    with pytest.raises(ValueError) as refusal:
        mistake()
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_rays_look_through_the_centers_of_cells():
    camera = mvtop.Camera(K, (640, 480))
    rays = mvtop.camera_rays(camera, [32, 64])
    assert rays.shape == (15 * 20 + 8 * 10, 3) and rays.dtype == np.float32
    u, v = np.meshgrid((np.arange(20) + 0.5) * 32 - 0.5, (np.arange(15) + 0.5) * 32 - 0.5)
    expected = camera.unproject(np.stack([u, v], axis=-1)).reshape(-1, 3)
    np.testing.assert_allclose(rays[:300], expected, atol=1e-6)
    # Half as large, in the upper half of a square.
    padded = mvtop.camera_rays(camera, [32], net_size=(320, 320)).reshape(10, 10, 3)
    assert (padded[8:] == 0).all() and (np.linalg.norm(padded[:7], axis=-1) > 0.999).all()


def test_plucker_moments_are_those_of_any_point_of_the_line(rng):
    rays = rng.normal(size=(20, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    ref_from_cam = pose(rng)
    lines = mvtop.encode_rays(rays, ref_from_cam)
    d, m = lines[:, :3], lines[:, 3:]
    np.testing.assert_allclose(d, rays @ ref_from_cam[:3, :3].T, atol=1e-6)
    point = ref_from_cam[:3, 3] + 1.7 * d
    np.testing.assert_allclose(m, np.cross(d, point), atol=1e-5)
    all_ = mvtop.encode_rays(rays, ref_from_cam, "plucker_origin")
    np.testing.assert_array_equal(all_[:, :6], lines)
    np.testing.assert_allclose(all_[:, 6:], np.tile(ref_from_cam[:3, 3], (20, 1)), atol=1e-6)
    assert mvtop.encode_rays(rays, ref_from_cam, "direction").shape == (20, 3)
    assert (mvtop.encode_rays(np.zeros((1, 3)), ref_from_cam) == 0).all()


def test_box_rays_are_those_of_its_middle_and_sides(rng):
    camera = mvtop.Camera(K, (640, 480), distortion=BROWN)
    ref_from_cam = pose(rng)
    turned = ref_from_cam[:3, :3]
    rays = mvtop.box_rays(camera, [100, 50, 180, 90], ref_from_cam)
    middle, left, right, top, bottom = camera.unproject(
        [[140, 70], [100, 70], [180, 70], [140, 50], [140, 90]]
    )
    expected = [ref_from_cam[:3, 3], turned @ middle]
    expected += [turned @ (right - left) * 5, turned @ (bottom - top) * 5]
    np.testing.assert_allclose(rays, np.concatenate(expected), atol=1e-5)


def test_six_numbers_give_the_rotation_of_the_conventions(rng):
    six = rng.normal(size=(3, 8, 6))
    rotations = mvtop.rotation_from_6d(six)
    x = six[..., :3] / np.linalg.norm(six[..., :3], axis=-1, keepdims=True)
    z = np.cross(x, six[..., 3:])
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    np.testing.assert_allclose(rotations, np.stack([x, np.cross(z, x), z], axis=-1), atol=1e-12)
