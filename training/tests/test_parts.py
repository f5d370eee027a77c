"""A user's part through a user's rig, and data sets of others: what is written is what was seen."""

import json
import shutil

import cv2
import numpy as np
import pytest
import trimesh

from mvtop_train.data import batches, bop, meshfile, objects, rig
from mvtop_train.data.bop import load_index
from mvtop_train.data.choice import choose_views, fixed_views
from mvtop_train.data.crops import Augmentation, Crops
from mvtop_train.data.views import ViewMaker
from mvtop_train.errors import UserError
from mvtop_train.network import config
from mvtop_train.network.coordinates import decode
from mvtop_train.synthesis import coordinates, parts, samples, scenes
from mvtop_train.synthesis.gl import open_gl

RED, BLUE = (200, 20, 20), (20, 20, 200)
# Of the two boxes below, mm: every point of the part lies on one of these planes.
PLANES = ([-20, 20], [-10, 0, 10], [-10, 5, 10, 30])


def bracket() -> trimesh.Trimesh:
    """Two boxes as an L, in mm, each of one color."""
    foot = trimesh.creation.box(bounds=[[-20, -10, -10], [20, 10, 5]])
    wall = trimesh.creation.box(bounds=[[-20, 0, 5], [20, 10, 30]])
    for box, color in ((foot, RED), (wall, BLUE)):
        box.visual.face_colors = [*color, 255]
    return trimesh.util.concatenate([foot, wall])


def rig_file(**changes) -> dict:
    """Two cameras that look at the same place, 45 degrees apart, with fx unlike fy."""
    c = float(np.sqrt(0.5))
    turned = [[c, 0, -c, 250 * c], [0, 1, 0, 0], [c, 0, c, 250 * (1 - c)], [0, 0, 0, 1]]
    lens = {"width": 160, "height": 120, "fx": 170, "fy": 150, "cx": 78, "cy": 61}
    cameras = [
        {"id": "front", **lens, "T_world_cam": {"t": [0, 0, 0], "q_wxyz": [1, 0, 0, 0]}},
        {"id": "side", **lens, "T_world_cam": turned},
    ]
    content = {"format": "mvtop-rig", "version": 1, "unit": "mm", "cameras": cameras}
    return {**content, **changes}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("part")
    bracket().export(folder / "bracket.ply")
    (folder / "rig.json").write_text(json.dumps(rig_file()))
    return folder


@pytest.fixture(scope="module")
def dataset(files):
    out = files / "data"
    mesh = meshfile.load_mesh(files / "bracket.ply", "mm")
    obj = objects.from_mesh(mesh, 1, "bracket")
    kit = parts.Kit([parts.Part(mesh, obj)])
    objects.write(out, [(obj, mesh)])
    cameras = rig.load(files / "rig.json")
    gl = open_gl()
    for number in range(2):
        rng = np.random.default_rng([3, number])
        pool = [scenes.noise_texture(rng)]
        views, names = parts.scene_views(gl, rng, pool, kit, lambda _: cameras)
        bop.write_scene(out / "train" / f"{number:06d}", views, names)
    return out


def test_the_object_is_read_back_from_the_data_set(dataset):
    obj = objects.read(dataset)
    assert (obj.id, obj.name) == (1, "bracket")
    assert obj.diameter_m == pytest.approx(0.06, abs=1e-5)  # of 40, 20, 40 mm: the corners'
    assert obj.extent_m == pytest.approx(0.03)
    assert (
        len(obj.points) == objects.POINTS and (np.ptp(obj.points, 0) > [0.039, 0.019, 0.039]).all()
    )
    colors = {tuple(row) for row in obj.colors.astype(int).tolist()}
    assert colors == {RED, BLUE}


def test_object_coordinates_lie_on_the_part(dataset):
    """Depth, pose, intrinsics and scale agree: else no back-projected pixel would hit a plane."""
    obj, checked = objects.read(dataset), 0
    for scene in load_index(dataset, obj=obj):
        for image in scene:
            rgb = cv2.imread(str(image.path))[:, :, ::-1].astype(int)
            coords, mask = decode(bop.read_coords(image, rgb.shape[:2])[0])
            points = coords[mask] * obj.extent_m * 1e3
            away = np.stack(
                [np.abs(points[:, [axis]] - PLANES[axis]).min(1) for axis in range(3)]
            ).min(0)
            assert away.max() < 0.3  # mm; 8 bits resolve 0.25 mm
            v, u = np.nonzero(mask)
            seen = rgb[v, u]
            wall, foot = points[:, 2] > 8, points[:, 2] < 3
            # Lights are colored at most a little: red stays redder than blue, and so on.
            for part, more, less in ((foot, 0, 2), (wall, 2, 0)):
                if part.sum() > 30:
                    assert seen[part, more].mean() > seen[part, less].mean()
                    checked += 1
    assert checked >= 3


def test_the_rig_keeps_its_shape(dataset, files):
    first, second = rig.load(files / "rig.json")
    expected = first.cam_from_rig @ np.linalg.inv(second.cam_from_rig)
    for scene in load_index(dataset, obj=objects.read(dataset)):
        a, b = scene
        relative = a.cam_from_world @ np.linalg.inv(b.cam_from_world)
        np.testing.assert_allclose(relative, expected, atol=1e-9)
        np.testing.assert_allclose(
            a.cam_from_obj, relative @ b.cam_from_obj, atol=1e-9
        )  # one part, one place
        np.testing.assert_allclose(a.k, first.k)
    names = json.loads((dataset / "train" / "000000" / "scene_camera.json").read_text())
    assert [names[key]["camera"] for key in sorted(names)] == ["front", "side"]


def test_views_without_hemispheres_can_be_drawn(dataset):
    obj = objects.read(dataset)
    scene = load_index(dataset, obj=obj)[0]
    rng = np.random.default_rng(0)
    drawn = {tuple(image.path for image in choose_views(scene, 2, rng)) for _ in range(20)}
    assert len(drawn) == 2  # both orders
    assert [len(views) for views in fixed_views(scene, 2, 5)] == [2, 2]


def test_crops_are_exact_cameras_with_unlike_focal_lengths(dataset):
    obj = objects.read(dataset)
    rng = np.random.default_rng(1)
    for image in load_index(dataset, obj=obj)[0]:
        for _ in range(4):
            choose = Crops(64, Augmentation(scale=1.0, diameter_px=(30, 50)))
            crop = choose(image, (480, 640), obj.bounds, rng, True)
            corner = np.append(obj.bounds[0], 1)
            old = image.k @ (image.cam_from_obj @ corner)[:3]
            new = crop.k @ crop.view_from_cam @ (image.cam_from_obj @ corner)[:3]
            a = crop.view_from_image(image.k)
            np.testing.assert_allclose(a[2], [0, 0, 1], atol=1e-12)
            np.testing.assert_allclose(
                a[:2] @ [*(old[:2] / old[2]), 1], new[:2] / new[2], atol=1e-6
            )


def crop_maker(obj) -> ViewMaker:
    network = config.preset("tiny", objects.classes_of(obj))
    return ViewMaker(Crops(64, Augmentation(scale=1.0)), network, (obj,))


def strip(dataset, out):
    """The same data set as others would have it: BOP's required files, png, no models_eval."""
    shutil.copytree(dataset, out)
    shutil.rmtree(out / "models_eval")
    path = out / "models" / "models_info.json"
    path.write_text(path.read_text().replace('"name": "bracket",', ""))
    for folder in (out / "train").iterdir():
        shutil.rmtree(folder / "coords")
        (folder / "scene_gt_info.json").unlink()
        for image in folder.glob("rgb/*.jpg"):
            cv2.imwrite(str(image.with_suffix(".png")), cv2.imread(str(image)))
            image.unlink()
    return out


def test_a_foreign_data_set_loads(dataset, tmp_path):
    ours = load_index(dataset, obj=objects.read(dataset))
    root = strip(dataset, tmp_path / "foreign")
    obj = objects.read(root)
    assert obj.name == "obj_000001" and len(obj.points) == objects.POINTS
    theirs = load_index(root, obj=obj)
    assert [len(scene) for scene in theirs] == [len(scene) for scene in ours]
    for a, b in zip(sum(ours, []), sum(theirs, []), strict=True):
        np.testing.assert_allclose(a.cam_from_obj, b.cam_from_obj)
        np.testing.assert_allclose(a.box, b.box.clip(-0.5, [159.5, 119.5] * 2), atol=0.01)
        view = crop_maker(obj).make_view(b, np.random.default_rng(0))
        assert view["image"].std() > 1 and (view["coords"] == 0).all()


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_missing_extrinsics_are_one_sentence(dataset, tmp_path):
    root = strip(dataset, tmp_path / "foreign")
    edit(root / "train" / "000000" / "scene_camera.json", lambda c: c["1"].pop("cam_t_w2c"))
    with pytest.raises(UserError, match="image 1: expected the camera's pose .* fix: "):
        load_index(root, obj=objects.read(root))


def test_of_several_objects_one_is_chosen(dataset, tmp_path):
    root = strip(dataset, tmp_path / "foreign")
    other = {"obj_id": 7, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 500]}
    edit(root / "train" / "000000" / "scene_gt.json", lambda gt: gt["0"].insert(0, other))
    obj = objects.read(root)
    chosen = load_index(root, obj=obj)[0][0]
    assert chosen.cam_from_obj[2, 3] != 0.5
    with pytest.raises(UserError, match="image 0: expected one object, got 2; fix: "):
        load_index(root)
    edit(root / "models" / "models_info.json", lambda info: info.update({"7": info["1"]}))
    with pytest.raises(UserError, match=r"expected one of \[1, 7\], got none chosen; fix: "):
        objects.read(root)


def test_all_instances_of_an_image_are_read(dataset, tmp_path):
    root = tmp_path / "several"
    shutil.copytree(dataset, root)
    folder, obj = root / "train" / "000000", objects.read(root)
    more = [
        {"obj_id": number, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 500]}
        for number in (1, 7)
    ]
    edit(folder / "scene_gt.json", lambda gt: gt["1"].extend(more))
    first, second = bop.read_images(folder)
    assert [(one.obj_id, one.annotation) for one in second.instances] == [(1, 0), (1, 1), (7, 2)]
    assert second.instances[1].cam_from_obj[2, 3] == 0.5 and second.instances[1].box is None
    assert (first.only.box == first.box).all() and first.only.visible_share > 0
    with pytest.raises(ValueError):
        second.only  # noqa: B018
    # Where the object is annotated twice, which of them is meant is not said.
    assert [image.number for image in bop.read_scene(folder, obj)] == [0]


def test_a_scene_that_is_not_whole_is_one_sentence(dataset, tmp_path):
    root = tmp_path / "broken"
    shutil.copytree(dataset, root)
    folder, obj = root / "train" / "000000", objects.read(root)
    (folder / "rgb" / "000001.jpg").unlink()
    with pytest.raises(UserError, match="rgb: image 1: expected a PNG, JPEG or .*; fix: "):
        load_index(root, obj=obj)
    (folder / "scene_gt.json").write_text("{")
    with pytest.raises(UserError, match="scene_gt.json: .*; fix: "):
        load_index(root, obj=obj)
    (root / "models" / "models_info.json").write_text("[]")
    with pytest.raises(UserError, match="models_info.json: .*; fix: "):
        objects.read(root)


def test_a_mesh_in_the_wrong_unit_is_refused(files):
    with pytest.raises(UserError, match="expected a part of 2 mm to 5 m, got 60 m .* fix: "):
        meshfile.load_mesh(files / "bracket.ply", "m")
    with pytest.raises(UserError, match="no such file; fix: "):
        meshfile.load_mesh(files / "none.ply", "mm")


@pytest.mark.parametrize("end", ["stl", "obj", "ply"])
def test_mesh_formats_give_the_same_part(files, tmp_path, end):
    path = tmp_path / f"bracket.{end}"
    bracket().export(path)
    obj = objects.from_mesh(meshfile.load_mesh(path, "mm"), 1, "bracket")
    assert obj.diameter_m == pytest.approx(0.06, abs=1e-5)
    part = parts.Part(meshfile.load_mesh(path, "mm"), obj)
    assert (part.texture is None) == (end == "stl")  # which has no colors


def test_a_rig_that_cannot_see_the_part_is_refused():
    lens = {"width": 160, "height": 120, "k": np.diag([150.0, 150, 1]), "distorted": False}
    lens["k"][:2, 2] = 79.5, 59.5
    apart = np.diag([-1.0, 1, -1, 1])  # back to back
    obj = objects.from_mesh(bracket().apply_scale(1e-3), 1, "bracket")
    cameras = [
        rig.Camera(id="a", cam_from_rig=np.eye(4), **lens),
        rig.Camera(id="b", cam_from_rig=apart, **lens),
    ]
    with pytest.raises(UserError, match="expected a place where 2 cameras see .* fix: "):
        parts.check_rig(cameras, obj, "rig.json")
    parts.check_rig(cameras[:1], obj, "rig.json")


def test_transforms_of_a_rig_by_hand(tmp_path):
    """A camera 1 m along x, turned by 90 degrees about z, in all four ways to say so."""
    half = float(np.sqrt(0.5))
    world_cam = [[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    cam_world = [[0, 1, 0, 0], [-1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]
    lens = {"width": 160, "height": 120, "fx": 150, "fy": 150, "cx": 79.5, "cy": 59.5}
    ways = [
        {"T_world_cam": world_cam},
        {"T_cam_world": cam_world},
        {"T_world_cam": {"t": [1, 0, 0], "q_wxyz": [half, 0, 0, half]}},
        {"T_world_cam": {"t": [1, 0, 0], "q_xyzw": [0, 0, half, half]}},
    ]
    path = tmp_path / "rig.json"
    for way in ways:
        path.write_text(json.dumps(rig_file(unit="m", cameras=[{"id": "a", **lens, **way}])))
        (camera,) = rig.load(path)
        np.testing.assert_allclose(camera.cam_from_rig, cam_world, atol=1e-12)


def test_a_smaller_width_is_the_same_camera():
    k = np.array([[1300.0, 0, 637.5], [0, 1310, 485.3], [0, 0, 1]])
    camera = rig.Camera("a", 1280, 960, k, np.eye(4), False)
    half = camera.at_width(640)
    assert (half.width, half.height) == (640, 480)
    pixel, small = k @ [0.1, -0.05, 1], half.k @ [0.1, -0.05, 1]
    np.testing.assert_allclose((pixel[:2] + 0.5) / 2 - 0.5, small[:2])
    assert camera.at_width(5000).width == 1280


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.pop("format"), '`format` is missing; write "format": "mvtop-rig"'),
        (lambda r: r.update(unit="inch"), 'got "inch"'),
        (lambda r: r.update(cameras=[]), "`cameras` must list 1 to 1000 cameras, got 0"),
        (lambda r: r["cameras"][0].pop("fx"), "camera `front`: the key `fx` is missing"),
        (
            lambda r: r["cameras"][1].pop("T_world_cam"),
            "camera `side`: its place is missing, give either",
        ),
        (
            lambda r: r["cameras"][1]["T_world_cam"][0].__setitem__(0, 2),
            "camera `side`, `T_world_cam`: the upper left 3x3 part is not a rotation",
        ),
    ],
)
def test_bad_rigs_are_one_sentence(tmp_path, change, message):
    content = rig_file()
    change(content)
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(content))
    with pytest.raises(UserError) as error:
        rig.load(path)
    assert message in str(error.value)
    assert str(error.value).endswith("fix: see docs/reference/rig-file.md")


def test_samples_of_a_data_set_hold_its_poses(dataset, tmp_path):
    obj = objects.read(dataset)
    samples.write_from_data(tmp_path, dataset, "train", obj, count=2, views=2)
    reference, other = load_index(dataset, obj=obj)[0]
    first, second = rig.load(tmp_path / "000000" / "rig.json")
    truth = json.loads((tmp_path / "000000" / "truth.json").read_text())["objects"][0]
    assert truth["class"] == "bracket" and set(truth["boxes"]) == {"cam0", "cam1"}
    for camera, image in ((first, reference), (second, other)):
        cam_from_obj = camera.cam_from_rig @ truth["T_world_obj"]
        np.testing.assert_allclose(cam_from_obj, image.cam_from_obj, atol=1e-9)
        saved = cv2.imread(str(tmp_path / "000000" / f"{camera.id}.png"))
        assert np.array_equal(saved, cv2.imread(str(image.path)))
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(UserError, match="expected a scene of 3 images, got none; fix: "):
        samples.write_from_data(tmp_path, dataset, "train", obj, count=2, views=3)


def test_a_part_makes_training_batches(dataset):
    """Two images per scene: never more views are drawn, though shares of three are asked for."""
    obj = objects.read(dataset)
    found, maker = batches.Scenes(dataset, (obj,), held_out=0), crop_maker(obj)
    stream = batches.Batches(
        batches.Fresh(found, maker), 4, (0.3, 0.3, 0.4), 5, rank=0, processes=1,
        more=batches.Negatives(found, maker.choose, 1), every=2,
    )  # fmt: skip
    shapes = set()
    for step in range(8):
        batch = stream[step]
        assert ("search_image" in batch) == (step % 2 == 0)
        shapes.add(tuple(batch["image"].shape[:2]))
        assert (batch["true_box"][..., 2:] > batch["true_box"][..., :2]).all()
        assert batch["coords"].any()
    assert shapes == {(4, 1), (2, 2)}


def test_coordinates_are_rendered_for_a_foreign_data_set(dataset, tmp_path):
    """As the generator wrote them, wherever the part was in sight."""
    root = strip(dataset, tmp_path / "foreign")
    obj = objects.read(root)
    ours = sum(load_index(dataset, obj=objects.read(dataset)), [])
    theirs = sum(load_index(root, obj=obj), [])
    render = coordinates.CoordinateRenderer(root, obj)
    for n, (a, b) in enumerate(zip(ours, theirs, strict=True)):
        expected = bop.read_coords(a, (120, 160))[0].astype(int)
        seen = (expected != 0).all(-1)
        with_mask = n % 2 == 0
        if with_mask:
            (b.path.parents[1] / "mask_visib").mkdir(exist_ok=True)
            mask = b.path.parents[1] / "mask_visib" / f"{b.path.stem}_000000.png"
            cv2.imwrite(str(mask), seen.astype(np.uint8) * 255)
        assert coordinates.write(b, render, obj) == with_mask
        again = bop.read_scene(b.path.parents[1], obj)[int(b.path.stem)]
        code = bop.read_coords(again, (120, 160))[0].astype(int)
        # Rounding to 8 bits may fall to either side; pixels on outlines to either face.
        assert (np.abs(code - expected)[seen].max(-1) <= 1).mean() > 0.97
        if with_mask:
            assert not code[~seen].any()
        view = crop_maker(obj).make_view(again, np.random.default_rng(0))
        assert view["coords"].any()
