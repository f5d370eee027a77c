"""Data sets are the same however they were made, and have the size that was asked for."""

import io
import json
import os
import queue
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from tqdm import tqdm

from mvtop_train import generate as command
from mvtop_train.data import bop, meshfile, objects, pairs, rendered
from mvtop_train.errors import UserError
from mvtop_train.evaluation import dataset_report
from mvtop_train.synthesis import catalogue, generate, recipe, scenes, workers


def make(out, *tasks):
    made = recipe.Recipe(seed=5, split="train", size=(192, 192))
    generate._ball_work((made, out, list(tasks), queue.SimpleQueue()))


def files(root) -> dict:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("mvball")
    objects.write(root, [(objects.ball(), objects.ball_mesh())])
    make(root, (0, 2), (1, 3))
    pairs.write(root / "train")
    return root


def test_shards_and_a_kill_do_not_change_the_data(dataset, tmp_path):
    make(tmp_path, (1, 3))
    # As a kill leaves it: an image cut short, the annotation not there yet.
    folder = tmp_path / "train" / "000001"
    (folder / "scene_gt.json").unlink()
    image = folder / "rgb" / "000001.jpg"
    image.write_bytes(image.read_bytes()[:100])
    make(tmp_path, (1, 3))
    expected = files(dataset / "train" / "000001")
    assert len(expected) == 9 and files(folder) == expected


def test_scenes_that_are_whole_are_left_alone(dataset):
    before = {p: p.stat().st_mtime_ns for p in dataset.rglob("*.jpg")}
    make(dataset, (0, 2), (1, 3))
    assert before == {p: p.stat().st_mtime_ns for p in dataset.rglob("*.jpg")}


def test_the_random_stream_of_a_scene_stays():
    """Held-out samples and data sets are named by their seed: this may never change."""
    rng = np.random.default_rng([1, recipe.SPLITS["train"], 0])
    model, _ = scenes.drop(rng, [scenes.noise_texture(np.random.default_rng(0))])
    assert model.ngeom == 9
    assert rng.random() == 0.44839630934448427


def test_views_per_scene_by_hand():
    assert recipe.views_per_scene(12, 6) == [6, 6]
    assert recipe.views_per_scene(14, 6) == [6, 6, 2]
    assert recipe.views_per_scene(13, 6) == [6, 7]  # one image alone would have no partner
    assert recipe.views_per_scene(4, 6) == [4]


@pytest.mark.parametrize("images", [*range(2, 40), *recipe.PAPER_IMAGES.values()])
def test_as_many_images_as_asked_for(images):
    counts = recipe.views_per_scene(images, 6)
    assert sum(counts) == images and min(counts) > 1 and max(counts) <= 7


def test_pairs_show_both_hemispheres():
    shows = dict(enumerate(["green", "red", "green", "red", "green"]))
    assert pairs.of_scene(shows) == [(0, 1), (1, 0), (2, 3), (3, 2), (4, 1)]
    assert pairs.of_scene({0: None, 4: None, 7: None}) == [(0, 4), (4, 7), (7, 0)]
    assert pairs.of_scene({3: None}) == []
    assert pairs.of_scene({0: "green", 1: "green"}) == []


def test_every_image_is_the_reference_of_one_written_pair(dataset):
    scenes_, images, count = pairs.write(dataset / "train")
    assert (scenes_, images, count) == (2, 5, 5)
    read = bop.load_index(dataset, obj=objects.read(dataset))
    for scene, a, b in pairs.read(dataset / "train"):
        assert {read[scene][a].shows, read[scene][b].shows} == {"green", "red"}


def test_another_recipe_is_refused(tmp_path):
    recipe.Recipe(seed=1, split="train", size=(640, 480)).check(tmp_path)
    recipe.Recipe(seed=1, split="train", size=(640, 480)).check(tmp_path)
    with pytest.raises(UserError, match="was made with seed 1, got 2"):
        recipe.Recipe(seed=2, split="train", size=(640, 480)).check(tmp_path)


MESHES = ("--mesh", "a.obj", "--mesh", "b.obj", "--mesh-unit", "mm")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--shard", "3/2"], "error: --shard: expected I/N with 0 <= I < N, got '3/2'"),
        (["--views", "0"], "error: --views: expected 1 to 1000, got 0"),
        (["--seed", "-1"], "error: --seed: expected 0 to 4294967295, got -1"),
        (["--workers", "100000"], "error: --workers: expected 1 to 1000, got 100000"),
        (["--out", "/proc/none"], "error: /proc/none: "),
        (["--paper", "--split", "control"], "error: --paper: expected a split of"),
        (["--mesh", "a.obj"], "error: --mesh-unit: expected with --mesh, got none"),
        ([*MESHES, "--id", "3"], "error: --id: expected one for each --mesh (2), got 1"),
        ([*MESHES, "--name", "x", "--name", "x"], "error: --name: expected each once, got x twice"),
        ([*MESHES], "error: mesh a.obj: no such file"),
        ([*MESHES, "--instances", "0"], "error: --instances: expected 1 to 100, got 0"),
    ],
)
def test_bad_options_are_one_sentence(monkeypatch, tmp_path, options, message):
    monkeypatch.setattr("sys.argv", ["generate", "--out", str(tmp_path), *options])
    with pytest.raises(SystemExit) as error:
        command.main()
    assert str(error.value).startswith(message) and "; fix: " in str(error.value)


def infos(folder, **of_objects):
    """A folder of meshes with a `models_info.json`, diameter and symmetry of each object."""
    folder.mkdir()
    turn = {"diameter": 50, "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    content = {number[1:]: turn | about for number, about in of_objects.items()}
    (folder / objects.INFO).write_text(json.dumps(content))
    return folder


def listed(*meshes, **given) -> list[tuple[int, str, int]]:
    """Id, name and number of axes of each part."""
    options = {"id": None, "name": None, "mesh_unit": "mm", **given}
    files = generate.part_files(SimpleNamespace(mesh=list(map(str, meshes)), **options))
    return [(part.id, part.name, len(part.symmetries[1])) for part in files]


def test_numbered_meshes_keep_their_numbers(tmp_path):
    bop_ = infos(tmp_path / "bop", _1={"name": "cup"}, _2={"name": "box"})
    of_bop = bop_ / "obj_000001.ply", bop_ / "obj_000002.ply"
    assert listed(of_bop[1], "other.obj") == [(2, "box", 1), (1, "other", 0)]
    assert listed("other.obj", *of_bop) == [(3, "other", 0), (1, "cup", 1), (2, "box", 1)]
    assert listed(of_bop[1], id=[7]) == [(7, "box", 1)]


def test_a_mesh_is_what_the_file_beside_it_tells_of(tmp_path):
    nut, tee = (infos(tmp_path / name, _1={}) / f"{name}.obj" for name in ("nut", "tee"))
    assert listed(nut, tee) == [(1, "nut", 1), (2, "tee", 1)]
    with pytest.raises(
        UserError, match=r"nut/models_info.json: expected object 2, .*, got \[1\]; fix"
    ):
        listed(nut, nut.with_name("bolt.obj"))  # whose the one entry is, is not said
    # Neither is it of a numbered mesh, nor of one of two in its folder.
    with pytest.raises(UserError, match=r"expected object 3, .*, got \[1\]; fix"):
        listed(nut.with_name("obj_000003.ply"))
    bolt = infos(tmp_path / "bolt", _7={}) / "bolt.stl"
    assert listed(bolt) == [(1, "bolt", 1)]
    for mesh in (bolt, bolt.with_name("nut.stl")):
        mesh.touch()
    with pytest.raises(UserError, match=r"expected object 1, .*, got \[7\]; fix"):
        listed(bolt)
    several = infos(tmp_path / "several", _1={}, _5={}) / "obj_000003.ply"
    with pytest.raises(UserError, match=r"expected object 3, .*, got \[1, 5\]; fix: "):
        listed(several)


def test_names_come_before_the_order_of_meshes(tmp_path):
    named = infos(
        tmp_path / "named",
        _1={"name": "nut"}, _2={"name": "bracket", "symmetries_continuous": []},
    )  # fmt: skip
    nut, bracket = named / "nut.stl", named / "bracket.stl"
    assert listed(bracket) == [(1, "bracket", 0)]
    assert listed(bracket, nut) == [(1, "bracket", 0), (2, "nut", 1)]


def test_names_are_of_files(tmp_path):
    folder = infos(tmp_path / "elbow", _1={"name": "elbow 1/2"})
    with pytest.raises(UserError, match="--name: expected names that files can have, got 'elbow 1"):
        listed(folder / "elbow.stl")


def test_what_is_told_of_another_part_is_refused(monkeypatch, tmp_path):
    options = box_beside_its_origin(tmp_path)
    (tmp_path / objects.INFO).write_text('{"1": {"diameter": 70}}')  # of 53.9
    monkeypatch.setattr("sys.argv", ["generate", *options])
    with pytest.raises(SystemExit) as error:
        command.main()
    assert "expected a diameter of 53.9 mm, that of box.stl, got 70.0 mm" in str(error.value)
    assert not (tmp_path / "train").exists()


def test_scenes_are_not_added_to_those_of_other_symmetries_or_textures(monkeypatch, tmp_path):
    monkeypatch.setattr(generate, "make_split", lambda *_: None)
    options = box_beside_its_origin(tmp_path)
    monkeypatch.setattr("sys.argv", ["generate", *options])
    command.main()
    command.main()
    turn = np.diag([-1.0, -1, 1, 1]).ravel().tolist()
    told = {"1": {"diameter": 53.9, "symmetries_discrete": [turn]}}
    (tmp_path / objects.INFO).write_text(json.dumps(told))
    with pytest.raises(SystemExit, match="was made with textures and symmetries '.*; fix: another"):
        command.main()


def test_meshes_that_would_fill_the_memory_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(meshfile, "MESH_TRIANGLES", 10)
    monkeypatch.setattr("sys.argv", ["generate", *box_beside_its_origin(tmp_path)])
    with pytest.raises(SystemExit, match="box.stl: expected 10 triangles at most, .*, got 12; fix"):
        command.main()


@pytest.mark.parametrize("number", [-1, 1_000_000])
def test_ids_that_no_file_can_have_are_refused_at_once(monkeypatch, tmp_path, number):
    arguments = [*box_beside_its_origin(tmp_path), "--id", str(number)]
    monkeypatch.setattr("sys.argv", ["generate", *arguments])
    with pytest.raises(SystemExit, match=f"--id: expected 0 to 999999, got {number}; fix"):
        command.main()
    assert not (tmp_path / "models").exists()


def test_out_that_is_a_file_is_one_sentence(monkeypatch, tmp_path):
    arguments = box_beside_its_origin(tmp_path)
    arguments[1] = str(tmp_path / "box.stl")
    monkeypatch.setattr("sys.argv", ["generate", *arguments])
    with pytest.raises(SystemExit, match="box.stl.*: expected a folder, got a file .*; fix"):
        command.main()


def box_beside_its_origin(folder) -> list[str]:
    box = trimesh.creation.box([40, 30, 20]).apply_translation([30, 0, 0])
    box.export(folder / "box.stl")
    return ["--out", str(folder), "--mesh", str(folder / "box.stl"), "--mesh-unit", "mm"]


def test_notes_are_lines(monkeypatch, tmp_path, capfd):
    """As `mvtop_train.run` finds them in the log."""
    lens = {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240}
    bent = {"model": "brown_conrady", "params": [0.1, 0, 0, 0, 0]}
    camera = {"id": "a", **lens, "distortion": bent, "T_world_cam": np.eye(4).tolist()}
    rig = {"format": "mvtop-rig", "version": 1, "unit": "m", "cameras": [camera]}
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    monkeypatch.setattr(generate, "make_split", lambda *_: None)
    options = [*box_beside_its_origin(tmp_path), "--rig", str(tmp_path / "rig.json")]
    monkeypatch.setattr("sys.argv", ["generate", *options])
    command.main()
    lens_, origin = capfd.readouterr().out.splitlines()
    assert lens_.startswith("note: images of a are rendered without distortion")
    assert origin.startswith("note: box: the mesh's origin is 30 mm off its middle")


@pytest.mark.parametrize("module", ["generate", "synthesis.coordinates"])
def test_without_opengl_one_sentence_says_so(module, dataset, tmp_path):
    """MuJoCo asks for it as soon as it is imported."""
    parts = module == "generate"
    options = box_beside_its_origin(tmp_path) if parts else ["--data", str(dataset)]
    made = subprocess.run(
        [sys.executable, "-m", f"mvtop_train.{module}", *options],
        env=os.environ | {"MUJOCO_GL": "nonsense"}, capture_output=True, text=True,
    )  # fmt: skip
    assert made.returncode == 1 and made.stderr.startswith(
        "error: rendering: expected off-screen OpenGL, got "
    )
    assert made.stderr.count("\n") == 1 and "; fix: " in made.stderr


def test_a_scene_is_not_whole_without_its_images(monkeypatch, tmp_path):
    view = rendered.View(np.eye(3), np.eye(4), [], np.zeros((4, 4, 3), np.uint8))
    monkeypatch.setattr(bop.cv2, "imwrite", lambda *_: False)  # as on a full disk
    with pytest.raises(UserError, match="000000.jpg: expected to write an image, .*; fix: "):
        bop.write_scene(tmp_path, [view])
    assert not bop.is_whole(tmp_path)


def test_scenes_of_several_parts_come_from_one_command(monkeypatch, tmp_path):
    models = tmp_path / "models"
    objects.write(tmp_path, catalogue.parts()[:2])
    meshes = [x for path in sorted(models.glob("*.ply")) for x in ("--mesh", str(path))]
    made = ["--out", str(tmp_path / "data"), *meshes, "--mesh-unit", "mm", "--width", "160"]
    made += ["--split", "test", "--scenes", "4", "--views", "2", "--workers", "1"]
    monkeypatch.setattr("sys.argv", ["generate", *made])
    command.main()
    whole = bop.whole_scenes(tmp_path / "data" / "test")
    images = [image for scene in whole for image in bop.read_images(scene)]
    seen = {one.obj_id for image in images for one in image.instances}
    assert seen == {1, 2} and max(len(image.instances) for image in images) == 2
    assert len(pairs.read(tmp_path / "data" / "test")) == len(images)


def test_the_report_counts_what_is_there(dataset, tmp_path):
    found = bop.read_split(dataset, "train", objects.read(dataset))
    stats = dataset_report.summary(dataset_report.statistics(found))
    assert (stats["scenes"], stats["images"], stats["pairs"]) == (2, 5, 5)
    assert sum(stats["images_by_hemisphere"].values()) == 5
    assert sum(stats["hemisphere_px"]["histogram"]) == 5
    assert stats["hemisphere_px"]["min_p5_median_p95_max"][0] > recipe.MIN_PIXELS["train"]
    assert 0.5 <= stats["distance_m"]["min_p5_median_p95_max"][0]
    assert 0 < stats["viewing_directions"]["hit"] <= 5 / dataset_report.DIRECTIONS
    sheet = dataset_report.contact_sheet(found, rows=1, columns=2, size=(60, 45))
    assert sheet.shape == (45 + 6, 2 * (120 + 6), 3)


def test_a_viewpoint_by_hand():
    """A camera on the object's +x, looking at it, with the object's z upwards."""
    cam_from_obj = np.array([[0, 1.0, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 2], [0, 0, 0, 1]])
    direction, roll = dataset_report.viewpoint(cam_from_obj)
    np.testing.assert_allclose(direction, [1, 0, 0])
    assert roll == pytest.approx(0)  # the object's y points to the right in the image


def refuse_the_first(job):
    tasks, done = job
    for task in tasks:
        if task == 0:
            raise UserError("no scene 0")
        time.sleep(60)


def test_what_a_worker_refuses_is_raised_at_once():
    """A pool would wait for ever for a process that exits, and for the others."""
    bar, begun = tqdm(total=3, disable=False, file=io.StringIO()), time.monotonic()
    with pytest.raises(UserError, match="^no scene 0$"):
        workers.run_workers(refuse_the_first, range(3), 2, lambda tasks, done: (tasks, done), bar)
    assert time.monotonic() - begun < 50


def crash_at_the_first(job):
    tasks, done = job
    for task in tasks:
        if task == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        done.put(task)


def test_a_worker_that_crashes_is_told_of():
    """As a graphics driver does now and then; the pool starts another one, which has no job."""
    bar = tqdm(total=3, disable=False, file=io.StringIO(), desc="rendering")
    with pytest.raises(UserError, match="^rendering: expected 2 processes to the end, got one"):
        workers.run_workers(crash_at_the_first, range(3), 2, lambda tasks, done: (tasks, done), bar)
