"""What a run's config file may say, and the sentence when it says something else."""

import os
from pathlib import Path

import pytest

from mvtop_train import run, shipped
from mvtop_train.errors import UserError
from mvtop_train.files import read_json
from mvtop_train.network import config as configs
from mvtop_train.network import losses
from mvtop_train.training import own_parts, runconfig

RUNS = sorted(shipped.FOLDER.glob(f"*{shipped.CONFIG}"))


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text('preset = "small"\nsteps = 5\n[generate]\nscenes = 2000\n')
    return path


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_the_runs_of_the_docs_read_and_are_written_out_whole(path, tmp_path):
    settings = runconfig.load(path)
    (tmp_path / "config.toml").write_text(runconfig.dump(settings))
    assert runconfig.load(tmp_path / "config.toml") == settings
    assert settings.network_config(()).preset == settings.preset


def test_changes_lie_on_top_of_what_holds_without_them(path):
    changes = ["lr=1", "views=[1, 3]", "network.closeup_strides=[16]", "loss.detection=1"]
    settings = runconfig.load(path, [*changes, "augmentation.zoom=[0.5, 1]", "data=a/b 😀"])
    assert (settings.lr, settings.views, settings.data) == (1.0, (1.0, 3.0), "a/b 😀")
    assert (settings.generate.scenes, settings.generate.test) == (2000, 100)
    assert dict(settings.loss) == {**losses.WEIGHTS, "detection": 1.0}
    network = settings.network_config(())
    assert network == configs.preset("small", (), closeup_strides=(16,))
    augmentation = settings.augmentation_of(network)
    assert (augmentation.zoom, augmentation.scale) == ((0.5, 1.0), 0.8)
    path.write_text(runconfig.dump(settings))
    assert runconfig.load(path) == settings


def test_a_kept_config_with_only_the_keys_that_were_given_is_the_same_run(tmp_path):
    (tmp_path / "config.toml").write_text(
        'data = "d"\nsteps = 5\nviews = [0, 1]\n\n[loss]\ndetection = 1\n\n[second]\nlr = 0.002\n'
    )
    settings = runconfig.load(tmp_path / "config.toml")
    runconfig.keep_copy(settings, tmp_path)
    assert runconfig.load(tmp_path / "config.toml") == settings
    other = settings.model_copy(update={"seed": 2})
    with pytest.raises(UserError, match="started with seed = 1, got 2; fix: another --out"):
        runconfig.keep_copy(other, tmp_path)


def test_other_parts_are_another_run_and_other_counts_and_spellings_are_not(path, monkeypatch):
    folder = path.parent
    given = ["backgrounds=photos", "generate.mesh=['a.obj']", "generate.rig=['rig.json']"]
    runconfig.keep_copy(runconfig.load(path, given), folder)
    (folder / "below").mkdir()
    monkeypatch.chdir(folder)
    runconfig.keep_copy(runconfig.load(path, given), folder)
    spelt = [f"backgrounds={folder}/photos/", "generate.mesh=['elsewhere/a.obj']"]
    runconfig.refuse_another(runconfig.load(path, [*given, *spelt, "generate.scenes=9"]), folder)
    for change in ("mesh_unit=cm", "id=[2]", "instances=2", "name=['x']"):
        other = runconfig.load(path, [*given, f"generate.{change}"])
        with pytest.raises(UserError, match=f"started with generate.{change.split('=')[0]} = "):
            runconfig.refuse_another(other, folder)


def test_of_a_checkpoint_whose_features_are_kept_the_path_may_change(path):
    changes = ["preset=tiny", "backbone=a/weights.pt"]
    runconfig.keep_copy(runconfig.load(path, changes), path.parent)
    runconfig.refuse_another(runconfig.load(path, [*changes, "backbone=b.pt"]), path.parent)
    with pytest.raises(UserError, match='started with backbone = "a checkpoint", got ""'):
        runconfig.refuse_another(runconfig.load(path, ["preset=tiny"]), path.parent)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ("lr=many", "key 'lr': expected a number, got 'many'; fix: for example lr = 0.001"),
        ("lr=0", "key 'lr': expected greater than 0, got 0"),
        ("lr=nan", "key 'lr': expected a finite number, got nan"),
        ("save_minutes=inf", "key 'save_minutes': expected a finite number, got inf"),
        ("lr.peak=1", "key 'lr': expected a number, got {'peak': 1}"),
        ("images=1.5", "key 'images': expected a whole number, got 1.5"),
        ("images=true", "key 'images': expected a whole number, got True"),
        ("images=2", "key 'images': expected at least as many as views of a scene, got 2"),
        ("data=3", "key 'data': expected text, got 3"),
        ("crop=100", "key 'crop': expected a multiple of 32, got 100"),
        ("precision=fp16", "key 'precision': expected 'auto', 'bf16' or 'fp32', got 'fp16'"),
        ("preset=big", "key 'preset': expected 'tiny', 'small' or 'lite', got 'big'"),
        ("views=3", "key 'views': expected a list, got 3"),
        ("views=[]", "key 'views': expected shares of 0 to 1, got ()"),
        ("views=[-1, 2]", "key 'views': expected at least 0, got -1"),
        ("second.views=[0]", "key 'second.views': expected shares of 0 to 1"),
        ("second.share=1", "key 'second.share': expected less than 1, got 1"),
        ("generate=3", "key 'generate': expected a table, got 3"),
        ("generate.scenes=0", "key 'generate.scenes': expected at least 1, got 0"),
        ("generate.scnes=9", "unknown key 'generate.scnes', expected one of id, instances, mesh,"),
        ("generate.name=['cap/red']", "expected names that files can have, got 'cap/red'; fix: "),
        ("generate.name=['']", "key 'generate.name': expected names that files can have"),
        ("loss.detection=-1", "key 'loss.detection': expected at least 0, got -1"),
        ("network.heads=x", "expected a whole number, got 'x'; fix: for example network.heads = 8"),
        ("network.mean=[1, 2]", "key 'network.mean': expected more entries, got (1, 2)"),
        ("network.los_encoding=x", "expected 'direction', 'origin_direction', 'plucker' or"),
        ("augmentation.zoom=[1, 'a']", "key 'augmentation.zoom': expected a number, got 'a'"),
        ("network.closeup=x", "fix: for example network.closeup = 160"),
        ("network.heads=3", "key 'network.heads': expected a divisor of d_model, got 3"),
        ("network.heads=0", "key 'network.heads': expected at least 1, got 0"),
        ("network.width=-1", "key 'network.width': expected at least 1, got -1"),
        ("network.strides=[16, 8]", "key 'network.strides': expected rising numbers of which"),
        ("network.closeup_strides=[7]", "key 'network.closeup_strides': expected rising numbers"),
        (
            "network.std=[0, 1, 1]",
            "key 'network.std': expected numbers above 0, got (0.0, 1.0, 1.0)",
        ),
        ("lr", "--set lr: expected key=value, got no '='"),
    ],
)
def test_what_cannot_be_is_one_clear_sentence(path, change, error):
    with pytest.raises(UserError) as refused:
        runconfig.load(path, [change])
    message = str(refused.value)
    assert error in message and "; fix: " in message and "\n" not in message
    assert message.startswith(("--set", f"{path}: "))


@pytest.mark.parametrize("change", ["network.height=360", "network.closeup=144"])
def test_sides_that_maps_of_all_strides_do_not_share_are_refused(path, change):
    key = change.split("=")[0]
    with pytest.raises(UserError, match=f"key '{key}': expected a multiple of 32, got .*; fix: "):
        runconfig.load(path, ["preset=lite", change])


@pytest.mark.parametrize("content", [b"steps = ", b"\xff\xfe", b"a = " + b"[" * 100_000])
def test_a_file_that_is_no_config_is_named(path, content):
    path.write_bytes(content)
    with pytest.raises(UserError, match=f"{path}: expected (TOML|text in UTF-8), got: .*; fix: "):
        runconfig.load(path)
    with pytest.raises(UserError, match="no such file"):
        runconfig.load(path.parent / "nowhere.toml")
    with pytest.raises(UserError, match="is a directory; fix: "):
        runconfig.load(path.parent)


RIG = str(RUNS[0].with_name("four.rig.json"))
PARTS = ("--mesh", "a.obj", "--mesh-unit", "mm", "--rig", RIG, "--out", "runs/mine")


def test_meshes_and_a_rig_stand_for_a_config(monkeypatch):
    monkeypatch.setattr("sys.argv", ["run", *PARTS, "--minutes", "9", "--set", "generate.test=4"])
    called = []
    monkeypatch.setattr(run.pipeline, "run", lambda *args: called.append(args))
    run.main()
    ((settings, folder, minutes),) = called
    assert (settings.preset, settings.minutes, settings.generate.test) == ("lite", 9, 4)
    assert settings.generate.mesh == ("a.obj",) and settings.generate.rig == (RIG,)
    assert (folder, minutes) == (Path("runs/mine"), 9)


@pytest.mark.parametrize("option", ["--mesh-unit", "--out", "--minutes"])
def test_what_meshes_need_is_asked_for(monkeypatch, option):
    given = [*PARTS, "--minutes", "9"]
    at = given.index(option)
    monkeypatch.setattr("sys.argv", ["run", *given[:at], *given[at + 2 :]])
    with pytest.raises(SystemExit, match=f"{option}: expected with --mesh, got none"):
        run.main()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ([*PARTS, "--minutes", "nan"], "--minutes: expected a number over 0, got nan"),
        ([*PARTS, "--minutes", "-3"], "--minutes: expected a number over 0, got -3"),
        ([*PARTS, "--minutes", "9", "--instances", "0"], "generate.instances': expected at least"),
        ([*PARTS, "--minutes", "9", "--name", "a/b"], "generate.name': expected names that files"),
        (["--config", str(RUNS[0]), "--rig", RIG], "--rig: expected with --mesh, got it with"),
        (["--config", str(RUNS[0]), "--mesh-unit", "mm"], "--mesh-unit: expected with --mesh"),
        (["--config", str(RUNS[0]), "--instances", "1"], "--instances: expected with --mesh"),
    ],
)
def test_options_that_cannot_be_or_do_not_count_are_refused(monkeypatch, options, error):
    monkeypatch.setattr("sys.argv", ["run", *options])
    with pytest.raises(SystemExit, match=error):
        run.main()


def of_parts(out, minutes, parts=4, instances=3, rigs=(RIG,)):
    meshes = tuple(f"{n}.obj" for n in range(parts))
    generate = {"mesh": meshes, "mesh_unit": "mm", "instances": instances, "rig": rigs}
    return own_parts.config(out, minutes, generate, "")


def test_a_run_keeps_its_scenes_whatever_its_minutes(tmp_path):
    begun = of_parts(tmp_path, 10)
    assert (begun.generate.scenes, begun.held_out, begun.generate.test) == (80, 16, 20)
    runconfig.keep_copy(begun, tmp_path)
    longer = of_parts(tmp_path, 60)
    assert longer == begun.model_copy(update={"minutes": 60})
    runconfig.refuse_another(longer, tmp_path)
    assert of_parts(tmp_path / "other", 60).generate.scenes == 480


def test_more_is_kept_for_the_end_of_more_parts_and_views(tmp_path):
    four = of_parts(tmp_path, 30).generate.reserve
    assert four == pytest.approx(1 + 0.06 * 48 + 0.05 * 20)
    assert of_parts(tmp_path, 30, rigs=()).generate.reserve == four
    three = of_parts(tmp_path, 30, rigs=(RIG.replace("four", "three"),)).generate.reserve
    assert three - 1 == pytest.approx((four - 1) * 3 / 4, abs=0.01)
    longer = of_parts(tmp_path, 60).generate.reserve
    more = of_parts(tmp_path, 60, parts=12)
    assert more.generate.reserve - 1 == pytest.approx((longer - 1) * 2)
    assert (more.held_out, more.generate.test) == (60, 30)
    assert of_parts(tmp_path, 30, parts=1, instances=1).generate.reserve > 1 + (four - 1) / 2


@pytest.mark.parametrize("minutes", [20, 30, 60])
def test_fewer_scenes_tell_of_many_parts_so_that_time_is_left_to_train(minutes, tmp_path):
    few, many = of_parts(tmp_path, minutes), of_parts(tmp_path, minutes, parts=60)
    assert few.generate.scenes == many.generate.scenes
    assert 8 <= many.held_out < few.held_out and 8 <= many.generate.test < few.generate.test
    assert many.generate.reserve <= 0.5 * minutes + 0.01


def test_values_that_are_nested_without_end_are_no_traceback(path):
    with pytest.raises(UserError, match="key 'lr': expected a number"):
        runconfig.load(path, ["lr=" + "[" * 100_000])


def test_config_that_may_not_end_is_refused_and_a_byte_order_mark_is_not(path):
    os.mkfifo(path.parent / "pipe.toml")
    for endless in (path.parent / "pipe.toml", Path("/dev/zero")):
        with pytest.raises(UserError, match="it is a pipe or device; fix: "):
            runconfig.load(endless)
    large = path.parent / "large.toml"
    large.write_bytes(b"#" * (1 << 20) + b"\n")
    with pytest.raises(UserError, match="expected 1048576 bytes at most"):
        runconfig.load(large)
    path.write_bytes("\ufeffsteps = 7\n".encode())
    assert runconfig.load(path).steps == 7


def test_json_with_a_key_twice_is_refused(path):
    path.write_text('{"pairs": [], "pairs": [[1, 2, 3]]}')
    with pytest.raises(UserError, match="the key 'pairs' twice in one object; fix: again"):
        read_json(path, "again")
