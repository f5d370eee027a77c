"""Cameras, rays, sampling and rotations as functions of arrays."""

import copy
import pickle

import cv2
import numpy as np
import pytest

import mvtop

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
BROWN = [0.09, -0.22, 0.001, -0.002, 0.05]
KANNALA = [-0.006, 0.016, -0.024, 0.0155]


def turn(rng, *shape):
    """Random rotations, from QR of random matrices."""
    q, r = np.linalg.qr(rng.normal(size=(*shape, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=-2, axis2=-1))[..., None, :]
    q[..., 0] *= np.linalg.det(q)[..., None]
    return q


def pose(rng, *shape):
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3] = turn(rng, *shape)
    matrix[..., :3, 3] = rng.normal(size=(*shape, 3))
    matrix[..., 3, 3] = 1
    return matrix


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
    rig, notes = mvtop.Rig.import_([file])
    assert rig.cameras[1].world_from_cam[:3, 3].tolist() == [0.1, 0, 0]
    assert any("world frame" in note for note in notes)
    with pytest.raises(ValueError, match="expected"):
        mvtop.Rig.import_([file], format="bop")
    with pytest.raises(ValueError, match="not known"):
        mvtop.Rig.import_([file], unit="furlong")
    with pytest.raises(FileNotFoundError):
        mvtop.Rig.import_([tmp_path / "none.yaml"])


def test_cameras_give_back_what_they_were_made_from(rng):
    world_from_cam = pose(rng)
    camera = mvtop.Camera(
        K, (640, 480), distortion=KANNALA, model="fisheye", world_from_cam=world_from_cam, id="left"
    )
    assert (camera.id, camera.size, camera.model) == ("left", (640, 480), "fisheye")
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


EYE = np.eye(4)
SKEW = np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, 0]])
MIRRORED = np.diag([1, 1, -1, 1.0])
MILLIMETRES = np.stack([EYE, EYE])
MILLIMETRES[1, 0, 3] = 800


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


def test_sampling_is_a_weighted_sum_of_bilinear_reads(rng):
    levels = [(4, 6), (2, 3)]
    value = rng.normal(size=(2, 30, 3, 5))
    locations = rng.uniform(-0.2, 1.2, size=(2, 7, 3, 2, 4, 2))
    weights = rng.uniform(size=(2, 7, 3, 2, 4))
    expected = np.zeros((2, 7, 3, 5))
    first = 0
    for level, (height, width) in enumerate(levels):
        cells = value[:, first : first + height * width].reshape(2, height, width, 3, 5)
        first += height * width
        x = locations[:, :, :, level, :, 0] * width - 0.5
        y = locations[:, :, :, level, :, 1] * height - 0.5
        for b, q, h, k in np.ndindex(2, 7, 3, 4):
            for row in range(height):
                for column in range(width):
                    share = max(0, 1 - abs(x[b, q, h, k] - column))
                    share *= max(0, 1 - abs(y[b, q, h, k] - row))
                    weight = weights[b, q, h, level, k] * share
                    expected[b, q, h] += weight * cells[b, row, column, h]
    sampled = mvtop.deformable_sampling(value, locations, weights, levels)
    np.testing.assert_allclose(sampled, expected.reshape(2, 7, 15), atol=1e-5)
    with pytest.raises(ValueError, match="value: expected"):
        mvtop.deformable_sampling(value[:, 1:], locations, weights, levels)


LEVELS = [(4, 6), (2, 3)]


def sampling_inputs(rng):
    """Value, locations and weights, float32; locations well between the centers of cells."""
    cells = rng.integers(-1, 3, size=(2, 7, 3, 2, 4, 2)) + rng.uniform(0.1, 0.9, (2, 7, 3, 2, 4, 2))
    sizes = np.array(LEVELS)[:, None, ::-1]  # width, height
    inputs = (
        rng.normal(size=(2, 30, 3, 5)),
        (cells + 0.5) / sizes,
        rng.uniform(size=(2, 7, 3, 2, 4)),
    )
    return [array.astype(np.float32) for array in inputs]


def test_sampling_writes_into_the_arrays_that_it_is_given(rng):
    inputs = sampling_inputs(rng)
    expected = mvtop.deformable_sampling(*inputs, LEVELS)
    out = np.full_like(expected, np.nan)
    for threads in (1, 3, 0):
        mvtop.set_num_threads(threads)
        out[:] = np.nan
        mvtop.deformable_sampling_forward(*inputs, LEVELS, out)
        np.testing.assert_array_equal(out, expected)


def test_gradients_of_sampling_are_slopes(rng):
    """The steepest of each input's, against a central difference."""
    inputs = sampling_inputs(rng)
    grad_out = rng.normal(size=(2, 7, 15)).astype(np.float32)
    grads = [np.full_like(array, np.nan) for array in inputs]
    mvtop.deformable_sampling_backward(*inputs, LEVELS, grad_out, *grads)
    for which, grad in enumerate(grads):
        index = np.unravel_index(np.abs(grad).argmax(), grad.shape)
        sums = []
        for step in (1e-3, -1e-3):
            moved = [array.copy() for array in inputs]
            moved[which][index] += step
            out = mvtop.deformable_sampling(*moved, LEVELS)
            sums.append((out.astype(float) * grad_out).sum())
        assert grad[index] == pytest.approx((sums[0] - sums[1]) / 2e-3, rel=0.01)


IN_PLACE = "expected a C-contiguous array of float32 with"


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda a: a.update(value=a["value"].astype(float)), f"value: {IN_PLACE} 4 axes, got fl"),
        (lambda a: a.update(value=a["value"].tolist()), f"value: {IN_PLACE} 4 axes, got <class"),
        (lambda a: a.update(locations=a["locations"][..., ::-1]), f"locations: {IN_PLACE} 6"),
        (lambda a: a.update(weights=a["weights"][..., 0]), f"weights: {IN_PLACE} 5 axes"),
        (lambda a: a.update(weights=a["weights"][:1].copy()), "weights: expected"),
        (lambda a: a.update(levels=[(4, 6)]), "value: expected"),
        (lambda a: a.update(levels=[(4, 0), (2, 3)]), "level: expected"),
        (lambda a: a.update(out=a["out"].reshape(2, 15, 7)), "out: expected shape [2, 7, 15], got"),
        (lambda a: a["out"].setflags(write=False), "out: "),
        (lambda a: a.update(out=a["value"].reshape(-1)[:210].reshape(2, 7, 15)), "out: "),
    ],
)
def test_sampling_in_place_refuses_what_it_would_have_to_copy(change, sentence, rng):
    names = ("value", "locations", "weights")
    arguments = dict(zip(names, sampling_inputs(rng), strict=True))
    arguments |= {"levels": LEVELS, "out": np.zeros((2, 7, 15), np.float32)}
    mvtop.deformable_sampling_forward(**arguments)
    change(arguments)
    with pytest.raises(ValueError) as refusal:
        mvtop.deformable_sampling_forward(**arguments)
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_six_numbers_give_the_rotation_of_the_conventions(rng):
    six = rng.normal(size=(3, 8, 6))
    rotations = mvtop.rotation_from_6d(six)
    x = six[..., :3] / np.linalg.norm(six[..., :3], axis=-1, keepdims=True)
    z = np.cross(x, six[..., 3:])
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    np.testing.assert_allclose(rotations, np.stack([x, np.cross(z, x), z], axis=-1), atol=1e-12)


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
    assert mvtop.statistics.auroc(scores, labels) == 2.5 / 4
    assert mvtop.statistics.auroc(scores, [True] * 4) is None
    curve = mvtop.statistics.roc_curve(scores, labels)
    np.testing.assert_array_equal(curve, [[0, 0], [0.5, 0.5], [0.5, 1], [1, 1]])
    assert mvtop.statistics.correlation([1, 2, 3], [4, 2, 0]) == pytest.approx(-1)
    assert mvtop.statistics.correlation([1, 1], [2, 3]) is None
    bins = mvtop.statistics.calibration([3, 1, 2, 4], [30, 10, 30, 60], bins=2)
    np.testing.assert_array_equal(bins, [[1.5, 20], [3.5, 45]])
    assert mvtop.statistics.calibration(np.arange(9), np.arange(9)).shape == (5, 2)
    with pytest.raises(ValueError, match="labels: expected 4 numbers, as many as of scores, got 3"):
        mvtop.statistics.auroc(scores, labels[1:])
