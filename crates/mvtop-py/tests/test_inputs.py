"""What predictions are made from: images of every kind, one group or several."""

import json

import numpy as np
import pytest
import torch
from PIL import Image, PngImagePlugin

import mvtop


def numbers(prediction):
    report = prediction.to_dict()
    del report["timings_ms"]
    return report


@pytest.fixture(scope="module")
def pictures(paths):
    pictures = [Image.open(path) for path in paths]
    for picture in pictures:
        picture.load()
    return pictures


@pytest.fixture(scope="module")
def expected(estimator, rig, paths, truth):
    return numbers(estimator.predict(paths, rig, boxes=truth))


KINDS = {
    "pillow": lambda pictures: pictures,
    "pillow with alpha": lambda pictures: [picture.convert("RGBA") for picture in pictures],
    "tensors": lambda pictures: [torch.from_numpy(np.array(p)) for p in pictures],
    "one tensor": lambda pictures: torch.from_numpy(np.stack([np.array(p) for p in pictures])),
    "tuple": lambda pictures: tuple(np.array(p) for p in pictures),
}


@pytest.mark.parametrize("kind", KINDS)
def test_images_of_every_kind_are_the_same(kind, estimator, rig, pictures, truth, expected):
    assert numbers(estimator.predict(KINDS[kind](pictures), rig, boxes=truth)) == expected


def test_several_groups_give_a_list(estimator, rig, paths, pictures, truth, expected):
    by_id = {camera.id: path for camera, path in zip(rig.cameras, paths, strict=True)}
    groups = [paths, by_id, pictures]
    found = estimator.predict(groups, rig, boxes=[truth, truth, truth])
    assert [numbers(one) for one in found] == [expected] * 3
    stacked = np.stack([np.array(p) for p in pictures])
    (alone,) = estimator.predict([stacked], rig, boxes=[truth])
    assert numbers(alone) == expected
    detected, given = estimator.predict([paths, paths], rig, boxes=[None, truth])
    assert numbers(given) == expected and detected.objects[0].score < 1


def test_mistakes_name_the_group(estimator, rig, paths, truth):
    with pytest.raises(ValueError, match="^group 1: images: expected 4, one for each camera"):
        estimator.predict([paths, paths[:2]], rig)
    with pytest.raises(ValueError, match="boxes: expected a list of 2, the boxes of each group"):
        estimator.predict([paths, paths], rig, boxes=truth)


REFUSED = {
    "channels first": (
        lambda p: torch.from_numpy(np.array(p)).permute(2, 0, 1),
        r"got channels first, \(3, 120, 160\); give `tensor.permute\(1, 2, 0\)`",
    ),
    "floats": (lambda p: torch.from_numpy(np.array(p)) / 255, "uint8 .* got float32"),
    "16 bits": (lambda p: p.convert("I"), "got an image of Pillow's mode I; scale it"),
    "a list": (lambda p: [[1]], "or a path, got"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_image_is_refused(case, estimator, rig, pictures):
    make, sentence = REFUSED[case]
    with pytest.raises(ValueError, match=sentence):
        estimator.predict({rig.cameras[0].id: make(pictures[0])}, rig)


def test_an_image_that_is_marked_as_turned_is_refused(estimator, rig, pictures):
    turned = pictures[0].copy()
    turned.getexif()[0x0112] = 6
    with pytest.raises(ValueError, match="EXIF orientation 6.; give it upright"):
        estimator.predict({rig.cameras[0].id: turned}, rig)


@pytest.mark.parametrize("chunks", [("gAMA",), ("gAMA", "sRGB"), ("usual",)])
def test_the_gamma_of_a_png_file_counts_for_paths_and_for_pillow(
    chunks, estimator, rig, pictures, truth, expected, tmp_path
):
    stated = {
        "gAMA": (b"gAMA", (100_000).to_bytes(4)),
        "usual": (b"gAMA", (45_455).to_bytes(4)),
        "sRGB": (b"sRGB", b"\0"),
    }
    for camera, picture in zip(rig.cameras, pictures, strict=True):
        told = PngImagePlugin.PngInfo()
        for name in chunks:
            told.add(*stated[name])
        picture.save(tmp_path / f"{camera.id}.png", pnginfo=told)
    files = [tmp_path / f"{camera.id}.png" for camera in rig.cameras]
    by_path = numbers(estimator.predict(files, rig, boxes=truth))
    assert by_path == numbers(estimator.predict([*map(Image.open, files)], rig, boxes=truth))
    assert (by_path == expected) == (chunks != ("gAMA",))


def test_more_objects_than_100_are_refused_whoever_gives_them(
    estimator, rig, paths, truth, cli, tmp_path
):
    many = truth * 101
    sentence = "boxes: expected those of 100 objects at most, got 101"
    with pytest.raises(ValueError, match=sentence):
        estimator.predict(paths, rig, boxes=many)
    file = tmp_path / "boxes.json"
    file.write_text(json.dumps({"objects": many}))
    folder = paths[0].parent
    done = cli(
        *("infer", "--model", folder.parent, "--rig", folder / "rig.json", *paths),
        *("--boxes", file),
    )
    assert done.returncode == 2 and sentence in done.stderr


def test_the_shipped_model_is_loaded_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mvball").mkdir()  # is not asked
    by_name = mvtop.Estimator.load("mvball")
    monkeypatch.delenv("MVTOP_MODEL", raising=False)
    assert by_name._path == mvtop.Estimator.load()._path
    with pytest.raises(FileNotFoundError, match="expected a model bundle there"):
        mvtop.Estimator.load("./mvball")


def test_an_interrupt_ends_a_prediction_and_the_next_one_is_whole(in_new_process):
    # Many boxes, so that it would take long; the first prediction takes the bounded way.
    script = """
import json, os, signal, threading, time, mvtop
# What is started in the background finds the signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
rig, images = mvtop.example()
estimator = mvtop.Estimator.load("mvball")
truth = json.load(open("examples/mvball/truth.json"))["objects"]
for _ in range(2):
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    start = time.perf_counter()
    try:
        estimator.predict(images, rig, boxes=truth * 100)
        raise SystemExit("was not interrupted")
    except KeyboardInterrupt:
        took = time.perf_counter() - start
    assert took < 8, took
found = estimator.predict(images, rig, boxes=truth)
assert len(found) == len(truth)
"""
    in_new_process(script, timeout=300)
