"""Data sets in BOP's layout, as NumPy's arrays in metres."""

import json

import cv2
import numpy as np
import pytest

import mvtop

K = [600, 0, 320, 0, 610, 240, 0, 0, 1]
TURNED = [0, -1, 0, 1, 0, 0, 0, 0, 1]  # by 90 degrees about z


def pose(obj_id, t):
    return {"obj_id": obj_id, "cam_R_m2c": TURNED, "cam_t_m2c": t}


@pytest.fixture
def scene(tmp_path):
    """Two images; in the second two instances of one object, and a bare third."""
    folder = tmp_path / "000003"
    (folder / "rgb").mkdir(parents=True)
    for name in ("000000.png", "000007.jpg"):
        (folder / "rgb" / name).touch()
    camera = {"cam_K": K, "depth_scale": 1.0}
    place = {"cam_R_w2c": TURNED, "cam_t_w2c": [0, 100, 2000], "camera": "wrist"}
    known = {
        "bbox_obj": [10, 20, 30, 40], "bbox_visib": [12, 20, 0, 5], "visib_fract": 0.25,
        "px_count_all": 800, "hemisphere": "red", "deep": {"list": [1, 2.5, None, True]},
    }  # fmt: skip
    hidden = {"bbox_obj": [-1] * 4, "bbox_visib": [-1] * 4, "visib_fract": 0.0}
    write(
        folder,
        scene_camera={"0": camera, "7": {**camera, **place, "cam_dist": [0.1, 0, 0, 0, 0]}},
        scene_gt={"0": [], "7": [pose(5, [10, 20, 900]), pose(5, [0, 0, 800]), pose(2, [0] * 3)]},
        scene_gt_info={"7": [known, hidden]},
    )
    return folder


def write(folder, **files):
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))


def test_a_scene_is_read_with_all_its_instances(scene):
    first, second = mvtop.bop.read_scene(scene)
    assert (first.number, first.sensor, first.path) == (0, "", scene / "rgb/000000.png")
    assert first.cam_from_world is None and first.instances == [] and first.more == {}
    np.testing.assert_array_equal(first.K, np.reshape(K, (3, 3)))
    assert first.distortion.size == 0
    assert (second.number, second.path.name) == (7, "000007.jpg")
    np.testing.assert_array_equal(second.distortion, [0.1, *[0] * 7])
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = np.reshape(TURNED, (3, 3)), [0, 0.1, 2]
    np.testing.assert_allclose(second.cam_from_world, expected, atol=1e-15)
    assert second.more == {"camera": "wrist"}
    assert repr(second) == "Image(000007, 3 instances)"

    one, hidden, unknown = second.instances
    assert [found.obj_id for found in second.instances] == [5, 5, 2]
    expected[:3, 3] = [0.01, 0.02, 0.9]
    np.testing.assert_allclose(one.cam_from_obj, expected, atol=1e-15)
    np.testing.assert_array_equal(one.box, [10, 20, 40, 60])
    np.testing.assert_array_equal(one.visible_box, [12, 20, 12, 25])  # one pixel wide
    assert (one.visible_share, hidden.visible_share) == (0.25, 0.0)
    more = {"px_count_all": 800, "hemisphere": "red", "deep": {"list": [1, 2.5, None, True]}}
    assert one.more == more and isinstance(one.more["px_count_all"], int)
    assert hidden.box is None and hidden.visible_box is None
    assert (unknown.box, unknown.visible_share, unknown.more) == (None, None, {})
    np.testing.assert_allclose(hidden.cam_from_obj[:3, 3], [0, 0, 0.8])


def test_what_is_not_unpacked_is_left_out_or_refused(scene):
    (scene / "rgb" / "000000.png").unlink()
    with pytest.warns(UserWarning, match="1 images .* not there and left out.*rgb/000000"):
        assert [image.number for image in mvtop.bop.read_scene(scene)] == [7]
    with pytest.raises(ValueError, match="rgb: image 0: expected a PNG, JPEG or TIFF file"):
        mvtop.bop.read_scene(scene, whole=True)
    (scene / "rgb" / "000000.png").touch()
    write(scene, scene_gt={"4": [pose(1, [0, 0, 900])]})
    assert len(mvtop.bop.read_scene(scene)) == 2
    with pytest.raises(ValueError, match="scene_gt.json: image 4: expected its camera in .*; add"):
        mvtop.bop.read_scene(scene, whole=True)


def test_what_is_not_bops_is_refused_in_one_sentence(scene, tmp_path):
    with pytest.raises(ValueError, match="expected scene_camera.json and images in rgb/ or gray/"):
        mvtop.bop.read_scene(tmp_path / "nowhere")
    (scene / "scene_gt.json").write_text('{"0": [')
    with pytest.raises(ValueError, match=r"scene_gt.json: .*expected \{IMAGE: ") as refused:
        mvtop.bop.read_scene(scene)
    assert "\n" not in str(refused.value)
    with pytest.raises(FileNotFoundError, match="models_info.json"):
        mvtop.bop.read_models_info(tmp_path / "models_info.json")


def test_models_come_in_metres_and_with_their_symmetries(tmp_path):
    path = tmp_path / "models_info.json"
    half_turn = [-1, 0, 0, 20, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    size = {"min_x": -10, "min_y": -20, "min_z": -30, "size_x": 20, "size_y": 50, "size_z": 60}
    axis = {"axis": [0, 0, 2], "offset": [1, 2, 0]}
    infos = {
        "4": {"diameter": 100, "name": "box", **size, "symmetries_discrete": [half_turn]},
        "12": {"diameter": 50.0, "symmetries_continuous": [axis]},
    }
    path.write_text(json.dumps(infos))
    read = mvtop.bop.read_models_info(path)
    assert list(read) == [4, 12]
    box, can = read[4], read[12]
    assert (box.name, box.diameter_m, can.name) == ("box", pytest.approx(0.1), None)
    np.testing.assert_allclose(box.bounds, [[-0.01, -0.02, -0.03], [0.01, 0.03, 0.03]])
    assert can.bounds is None and can.symmetries_discrete.shape == (0, 4, 4)
    expected = np.diag([-1.0, -1, 1, 1])
    expected[0, 3] = 0.02
    np.testing.assert_allclose(box.symmetries_discrete, [expected], atol=1e-15)
    ((direction, offset),) = can.symmetries_continuous
    np.testing.assert_allclose(direction, [0, 0, 1])
    np.testing.assert_allclose(offset, [0.001, 0.002, 0])
    for info, motions in ((box, 2), (can, 315)):
        given = info.symmetries_discrete, info.symmetries_continuous
        assert len(mvtop.metrics.Symmetries(*given)) == motions
    path.write_text('{"1": {"diameter": 0}}')
    with pytest.raises(ValueError, match="object 1: expected a diameter in millimetres, got 0"):
        mvtop.bop.read_models_info(path)


@pytest.fixture
def dataset(tmp_path):
    """A square plate of 100 mm, 0.9 m before each of two cameras."""
    folder = tmp_path / "plates" / "test" / "000001"
    (folder / "rgb").mkdir(parents=True)
    for name in ("000000.png", "000001.png"):
        cv2.imwrite(str(folder / "rgb" / name), np.zeros((480, 640, 3), np.uint8))
    plate = {"obj_id": 3, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 900]}
    write(
        folder,
        scene_camera={str(i): {"cam_K": K, "depth_scale": 1.0} for i in range(2)},
        scene_gt={str(i): [plate] for i in range(2)},
    )
    models = tmp_path / "plates" / "models"
    models.mkdir()
    (models / "models_info.json").write_text('{"3": {"diameter": 141.4}}')
    corners = "v -50 -50 0\nv 50 -50 0\nv 50 50 0\nv -50 50 0\nf 1 2 3 4\n"
    (models / "obj_000003.obj").write_text(corners)
    return tmp_path / "plates"


def test_results_are_scored(dataset, tmp_path):
    line = "1,{},{},0.9,1 0 0 0 1 0 0 0 1,{} 0 900,0.5\n"
    exact, other = tmp_path / "exact.csv", tmp_path / "other.csv"
    exact.write_text(mvtop.BOP_RESULTS_HEADER + line.format(0, 3, 0) + line.format(1, 3, 0))
    other.write_text(line.format(1, "plate", 30))  # off by 0.212 diameters, 20 px
    scores = mvtop.bop.evaluate(dataset, exact)
    assert scores["all"]["objects"] == scores["all"]["found"] == 2
    assert (scores["all"]["ar_mssd"], scores["all"]["ar_mspd"]) == (1, 1)
    assert scores["time_mean_s"] == 0.5
    both = mvtop.bop.evaluate(
        dataset, [exact, other], names={"plate": 3}, report=tmp_path / "report"
    )
    assert both["exact"]["all"] == scores["all"]
    all_objects = both["other"]["all"]
    assert all_objects["found"] == 1
    # One of two is right at 0.25 to 0.5 diameters: 6 of 10; at 25 to 50 px, 20 px * 640 / 640: 6.
    assert (all_objects["ar_mssd"], all_objects["ar_mspd"]) == (0.3, 0.3)
    assert (tmp_path / "report" / "other" / "report.html").exists()
    assert list(mvtop.bop.evaluate(dataset, [exact])) == ["exact"]
    with pytest.raises(ValueError, match="other.csv: line 1: obj_id: .*--map NAME=ID"):
        mvtop.bop.evaluate(dataset, other)
    with pytest.raises(FileNotFoundError, match="nothing.csv"):
        mvtop.bop.evaluate(dataset, tmp_path / "nothing.csv")


THEN = {
    "evaluate": "mvtop.bop.evaluate(dataset, results)",
    "the command": """
command = ["eval", "bop", "--dataset", dataset, "--predictions", results]
assert mvtop._mvtop.run_cli(["mvtop-cli", *command], "") == 0
""",
    "others": "mvtop.camera_rays(mvtop.Camera(np.eye(3), (64, 48)), [8])",
}


@pytest.mark.parametrize("then", THEN)
def test_forked_processes_compute_after_an_evaluation(then, dataset, tmp_path, in_new_process):
    depth = dataset / "test" / "000001" / "depth"
    depth.mkdir()
    for name in ("000000.png", "000001.png"):
        cv2.imwrite(str(depth / name), np.full((480, 640), 900, np.uint16))
    results = tmp_path / "results.csv"
    results.write_text("1,0,3,0.9,1 0 0 0 1 0 0 0 1,3 0 900,0.5\n")
    script = """
import os, signal, sys
import numpy as np, mvtop
dataset, results, then = sys.argv[1:]
assert mvtop.bop.evaluate(dataset, results)["all"]["ar_vsd"] > 0
child = os.fork()
if child == 0:
    signal.alarm(60)  # what hangs dies
    exec(then)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""
    in_new_process(script, dataset, results, THEN[then])


def test_rotations_that_are_off_are_made_exact_with_a_warning(scene):
    content = json.loads((scene / "scene_gt.json").read_text())
    content["7"][1]["cam_R_m2c"] = [entry * 1.005 for entry in TURNED]
    write(scene, scene_gt=content)
    with pytest.warns(UserWarning, match="1 of 3 rotations .* image 7, row 1") as warned:
        image = mvtop.bop.read_scene(scene)[1]
    assert warned[0].filename == __file__
    exact = image.instances[1].cam_from_obj[:3, :3]
    np.testing.assert_allclose(exact, np.reshape(TURNED, (3, 3)), atol=1e-14)


def test_metrics_take_rotations_that_are_off_with_a_warning():
    surface = mvtop.metrics.Surface([[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])
    poses = np.stack([np.eye(4)] * 3)
    poses[1, :3, :3] *= 1.005
    with pytest.warns(UserWarning, match="1 of 3 rotations of truth .*1.0e-2 .truth, pose 1"):
        errors = surface.add(poses, np.eye(4))
    np.testing.assert_allclose(errors, 0, atol=1e-15)
    poses[2, :3, :3] *= 1.02
    with pytest.raises(ValueError, match="truth, pose 2: "), pytest.warns(UserWarning):
        surface.add(poses, np.eye(4))
