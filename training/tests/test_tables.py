"""Statistics of results by hand; the driver with a stand-in for `mvtop-cli`."""

import json
import stat
import subprocess
import sys

import numpy as np
import pytest

from mvtop_train.errors import UserError
from mvtop_train.study import pictures, results, tables


def line(sample: str, rot=None, sigma=None, views=2) -> dict:
    found = rot is not None
    return {
        "sample": sample, "views": views, "found": found, "rot_deg": rot,
        "trans_m": 0.01 if found else None, "add_m": 0.02 if found else None,
        "sigma": {"rot_deg": sigma, "t_m": 0.003} if found else None,
    }  # fmt: skip


def write(path, lines) -> results.Results:
    path.write_text("".join(json.dumps(x) + "\n" for x in lines))
    return results.read(path)


def test_results_are_read_with_what_was_not_found(tmp_path):
    run = write(tmp_path / "r.jsonl", [line("a", 4.0, 5.0), line("b"), line("c", 8.0, 7.0)])
    assert run.found.tolist() == [True, False, True]
    assert run.views == 2
    assert results.mean(run.rot_deg) == (6.0, pytest.approx(2.0))  # deviation sqrt(8) over sqrt(2)
    assert tables.cells(run)[:3] == ["2/3", "6.00 ± 2.00", "6.00"]
    lost = write(tmp_path / "lost.jsonl", [line("a"), line("b")])
    assert tables.cells(lost)[:2] == ["0/2", "-"]


@pytest.mark.parametrize("text", ["", "[]", '{"sample": "a"}\n', "\0"])
def test_other_files_are_refused_in_one_sentence(tmp_path, text):
    (tmp_path / "r.jsonl").write_text(text)
    with pytest.raises(UserError, match=r".*; fix: mvtop-cli eval") as refused:
        results.read(tmp_path / "r.jsonl")
    assert "\n" not in str(refused.value)


def test_roc_by_hand():
    # Resolved poses expect 1 and 3, others 2 and 3: in order, not, in order, equal.
    sigma, resolved = np.array([1.0, 3.0, 2.0, 3.0]), np.array([True, True, False, False])
    fpr, tpr, area = results.roc(sigma, resolved)
    assert fpr.tolist() == [0, 0.5, 0.5, 1]
    assert tpr.tolist() == [0, 0.5, 1, 1]
    assert area == 2.5 / 4
    assert np.isnan(results.roc(sigma, np.ones(4, bool))[2])


def test_area_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    sigma, resolved = rng.integers(0, 9, 60).astype(float), rng.random(60) < 0.4
    low, high = sigma[resolved][:, None], sigma[~resolved]
    share = ((high > low) + (high == low) / 2).mean()
    assert results.roc(sigma, resolved)[2] == pytest.approx(share)


def test_pooling_one_and_two_views_tells_what_neither_can_alone(tmp_path):
    two = write(tmp_path / "2.jsonl", [line(str(i), 3.0, 4.0) for i in range(3)])
    one = write(tmp_path / "1.jsonl", [line(str(i), 40.0, 30.0, 1) for i in range(3)])
    assert np.isnan(results.pooled_roc([two])[2])
    assert results.pooled_roc([one, two])[2] == 1.0
    assert results.pooled_roc([one, two], resolved_deg=50.0)[2] != 1.0  # nothing is unresolved


def test_calibration_bins_follow_what_was_expected(tmp_path):
    order = np.random.default_rng(1).permutation(20)
    run = write(tmp_path / "r.jsonl", [line(str(i), 2.0 * i, 1.0 * i) for i in order])
    expected, actual = results.calibration(run, bins=4)
    assert expected.tolist() == [2, 7, 12, 17]
    assert actual.tolist() == [4, 14, 24, 34]
    assert len(results.calibration(run, bins=10)[0]) == 4  # five poses a bin at least
    assert results.correlation(run) == pytest.approx(1.0)


FAKE_CLI = """#!{python}
import json, os, sys
arguments = sys.argv[1:]
value = lambda key: arguments[arguments.index(key) + 1]
views, worse = int(value("--views")), float("noise" in " ".join(arguments))
with open(value("--out"), "w") as out:
    for i in range(6):
        rot = (30 if views == 1 else 2) + i + 10 * worse
        out.write(json.dumps({{"sample": str(i), "views": views, "found": True, "rot_deg": rot,
            "trans_m": 0.01, "add_m": 0.02, "sigma": {{"rot_deg": rot + 1, "t_m": 0.1}}}}) + "\\n")
with open("{log}", "a") as log:
    print(*arguments, file=log)
"""


def test_tables_and_pictures_are_made_and_finished_runs_are_kept(tmp_path, monkeypatch, capsys):
    cli, log, out = tmp_path / "cli", tmp_path / "log", tmp_path / "out"
    cli.write_text(FAKE_CLI.format(python=sys.executable, log=log))
    cli.chmod(cli.stat().st_mode | stat.S_IXUSR)
    (tmp_path / "model").mkdir()
    (tmp_path / "model/model.json").write_text("{}")
    for split in ("hard", "easy"):
        sample = tmp_path / f"samples/{split}-seed0-views8-1/000000"
        sample.mkdir(parents=True)
        (sample / "truth.json").write_text("{}")
    arguments = ["tables", "--cli", str(cli), "--model", str(tmp_path / "model"), "--pairs", "1"]
    arguments += ["--samples", str(tmp_path / "samples"), "--out", str(out)]
    arguments += ["--images", str(tmp_path / "images")]
    monkeypatch.setattr(sys, "argv", arguments)
    tables.main()

    calls = log.read_text().splitlines()
    assert len(calls) == len(set(calls)) == len(tables.conditions(["hard", "easy"]))
    noise = [call for call in calls if "noise" in call]
    assert len(noise) == 12
    assert all(("--box-noise" in call) == ("--true-boxes" in call) for call in noise)
    text = (out / "tables.md").read_text()
    # 2 to 7 degrees: mean 4.5, deviation sqrt(3.5).
    assert "| hard | 2 | detected | 6/6 | 4.50 ± 0.76 | 4.50 | 0.0 % | 20.0 | 10.0 | 5.50 |" in text
    assert "| hard | 1 and 2 | 50 % | 1.000 | - |" in text
    names = {path.name for path in out.glob("*.png")}
    assert len(names) == 7
    assert {path.name for path in (tmp_path / "images").iterdir()} == names
    assert all(path.stat().st_size < 150_000 for path in out.glob("*.png"))

    (out / "hard/views2.jsonl").unlink()
    tables.main()
    assert len(log.read_text().splitlines()) == len(calls) + 1

    (tmp_path / "model/model.json").write_text('{"another": 1}')
    with pytest.raises(SystemExit, match="results of another model"):
        tables.main()
    capsys.readouterr()


def test_command_that_cannot_run_is_one_sentence():
    with pytest.raises(UserError, match=r"^cannot run /none.*; fix: cargo build"):
        tables.call(["/none"])
    with pytest.raises(UserError, match="failed with code 3"):
        tables.call([sys.executable, "-c", "raise SystemExit(3)"])


def test_cut_shows_the_box_in_the_middle_of_the_cell():
    image = np.zeros((100, 200, 3), np.uint8)
    image[40:60, 120:140] = 255  # pixels 120 to 139: the box spans 119.5 to 139.5
    box = [119.5, 39.5, 139.5, 59.5]
    left, top, side = pictures.window(box)
    assert side == 20 * (1 + pictures.MARGIN)
    assert (left + side / 2, top + side / 2) == (129.5, 49.5)
    bright = np.argwhere(pictures.cut(image, box)[:, :, 0] > 127)
    center = (bright.min(0) + bright.max(0)) / 2
    assert np.abs(center - (pictures.CELL - 1) / 2).max() <= 0.5
    extent = bright.max(0) - bright.min(0) + 1
    assert np.abs(extent - pictures.CELL / (1 + pictures.MARGIN)).max() <= 2


def test_pictures_refuse_what_are_no_results(tmp_path):
    command = [sys.executable, "-m", "mvtop_train.study.pictures", "--results", str(tmp_path)]
    command += ["--samples", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
