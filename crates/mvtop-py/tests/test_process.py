"""mvtop as one module among others: imports, threads, forks."""

import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import mvtop
from mvtop import _runtime

# Predicts in this process and compares with what the first prediction gave.
HEAD = """
import sys, mvtop
sample = "fixtures/tiny/sample"
rig = mvtop.Rig.load(f"{sample}/rig.json")
images = [f"{sample}/{camera.id}.png" for camera in rig.cameras]
def pose(estimator):
    found = estimator.predict(images, rig, boxes=f"{sample}/truth.json").objects
    return found[0].ref_from_obj.tolist()
"""


def test_import_brings_nothing_else_along(in_new_process):
    script = """
import os, sys, threading
before, variables = set(sys.modules), dict(os.environ)
import mvtop
brought = {name.split(".")[0] for name in set(sys.modules) - before}
heavy = brought & {"numpy", "onnxruntime", "torch", "rerun", "subprocess", "asyncio"}
assert not heavy, heavy
assert dict(os.environ) == variables and threading.active_count() == 1
assert not os.path.exists("/proc/self/task") or len(os.listdir("/proc/self/task")) == 1
"""
    in_new_process(script)


@pytest.mark.parametrize("other", ["onnxruntime", "torch"])
@pytest.mark.parametrize("first", [True, False])
def test_works_beside(other, first, in_new_process):
    use = {
        "onnxruntime": """
session = onnxruntime.InferenceSession("fixtures/tiny/portable/features.onnx")
assert session.get_inputs()
""",
        "torch": "assert torch.ones(300, 300).mm(torch.ones(300, 300))[0, 0] == 300\n",
    }[other]
    predict = HEAD + "here = pose(mvtop.Estimator.load('fixtures/tiny'))\n"
    parts = [f"import {other}\n{use}", predict]
    script = (
        "".join(parts if first else reversed(parts))
        + use
        + ("assert pose(mvtop.Estimator.load('fixtures/tiny')) == here\n")
    )
    in_new_process(script)


def test_threads_share_an_estimator(in_new_process):
    script = (
        HEAD
        + """
from concurrent.futures import ThreadPoolExecutor
estimator = mvtop.Estimator.load("fixtures/tiny", threads=2)
with ThreadPoolExecutor(4) as threads:
    poses = list(threads.map(lambda _: pose(estimator), range(12)))
assert all(p == poses[0] for p in poses)
"""
    )
    in_new_process(script)


def test_threads_share_tracks(in_new_process):
    script = (
        HEAD
        + """
from concurrent.futures import ThreadPoolExecutor
mvtop.set_num_threads(2)
estimator, tracks = mvtop.Estimator.load("fixtures/tiny", threads=1), mvtop.Tracks()
def number(_):
    (found,) = estimator.predict(images, rig, boxes=f"{sample}/truth.json", tracks=tracks)
    return found.track_id
with ThreadPoolExecutor(4) as threads:
    assert set(threads.map(number, range(12))) == {1}
"""
    )
    in_new_process(script)


def test_threads_share_a_tracker_in_a_pool_of_its_own(in_new_process):
    # Of the compiled part, to which the tracker's own lock lets one thread at a time. The second
    # call comes at any moment of the first, so that a thread of the pool that waits takes it up.
    script = """
import time, mvtop
from concurrent.futures import ThreadPoolExecutor
mvtop.set_num_threads(2)
rig, images = mvtop.example()
tracker = mvtop.Tracker(mvtop.Estimator.load("models/mvball", threads=1), rig)
tracker.update(images)
def predict():
    tracker._native.predict(None, None, None, 1, None)
predict()
start = time.perf_counter()
predict()
took = time.perf_counter() - start
with ThreadPoolExecutor(2) as threads:
    for part in range(20):
        calls = [threads.submit(predict)]
        time.sleep(took * part / 20)
        calls.append(threads.submit(predict))
        for call in calls:
            call.result()
"""
    in_new_process(script, timeout=120)


def test_python_runs_on_while_it_computes(in_new_process):
    # Under Python's lock, no other thread could note a time within a call.
    script = (
        HEAD
        + """
import threading, time
estimator = mvtop.Estimator.load("fixtures/tiny")
noted, done = [], threading.Event()
def note():
    while not done.is_set():
        noted.append(time.perf_counter())
        time.sleep(0.0005)
threading.Thread(target=note, daemon=True).start()
within = 0
for _ in range(200):
    start = time.perf_counter()
    estimator._native.predict(rig, list(enumerate(images)), None, None, None, 1, None, None)
    end = time.perf_counter()
    margin = (end - start) / 4
    within += sum(start + margin < t < end - margin for t in list(noted))
    if within > 3:
        break
done.set()
assert within > 3
"""
    )
    in_new_process(script)


FORKS = {
    "os.fork": """
import os
child = os.fork()
if child == 0:
    os._exit(0 if pose(estimator) == here else 1)
assert os.waitpid(child, 0)[1] == 0
""",
    # The child ends as a program does, so that all it has is dropped.
    "fork and exit": """
import os
child = os.fork()
if child == 0:
    assert pose(estimator) == here
    del estimator
    sys.exit(0)
assert os.waitpid(child, 0)[1] == 0
""",
    "multiprocessing": """
import multiprocessing
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map(pose, [estimator] * 4) == [here] * 4
""",
    "fork of a fork": """
import os
child = os.fork()
if child == 0:
    assert pose(estimator) == here
    grandchild = os.fork()
    if grandchild == 0:
        os._exit(0 if pose(estimator) == here else 1)
    os._exit(os.waitpid(grandchild, 0)[1] != 0)
assert os.waitpid(child, 0)[1] == 0
""",
    # At moments at which the threads hold whatever lock they take.
    "many while threads predict": """
import os, signal, threading
done, wrong = threading.Event(), []
def work():
    while not done.is_set() and not wrong:
        if pose(estimator) != here:
            wrong.append("a thread's pose")
threads = [threading.Thread(target=work) for _ in range(2)]
for thread in threads:
    thread.start()
for _ in range(12):
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # what hangs dies
        os._exit(0 if pose(estimator) == here else 1)
    if os.waitpid(child, 0)[1] != 0:
        wrong.append("a forked process")
done.set()
for thread in threads:
    thread.join()
assert not wrong, wrong
""",
}


@pytest.mark.parametrize("how", FORKS)
def test_forked_processes_predict_the_same(how, in_new_process):
    script = (
        HEAD
        + """
estimator = mvtop.Estimator.load("fixtures/tiny", threads=2)
here = pose(estimator)
"""
        + FORKS[how]
        + """
assert pose(estimator) == here
"""
    )
    in_new_process(script)


def test_forked_processes_draw_the_same_edges(in_new_process):
    script = """
import os, signal, mvtop
rig, images = mvtop.example()
prediction = mvtop.Estimator.load("models/mvball").predict(images, rig)
here = prediction.overlay(edges=True)
child = os.fork()
if child == 0:
    signal.alarm(60)  # what hangs dies
    there = prediction.overlay(edges=True)
    os._exit(any((there[camera] != here[camera]).any() for camera in here))
assert os.waitpid(child, 0)[1] == 0
"""
    in_new_process(script)


# Counts this process's threads, and computes in those of mvtop.
THREADS = """
import os
import numpy as np, mvtop
def threads():
    return len(os.listdir("/proc/self/task"))
def sample():
    mvtop.deformable_sampling(np.ones((1, 1, 1, 1)), np.ones((1, 999, 1, 1, 1, 2)),
                              np.ones((1, 999, 1, 1, 1)), [(1, 1)])
before = threads()
"""


def test_a_number_of_threads_that_comes_again_makes_none_anew(in_new_process):
    script = """
for count in [1, 2] * 50:
    mvtop.set_num_threads(count)
    sample()
assert threads() == before + 1 + 2, threads()
"""
    in_new_process(THREADS + script)


def test_library_keeps_nothing_of_its_user(tmp_path, monkeypatch, in_new_process):
    monkeypatch.setenv("HOME", str(tmp_path))
    for variable in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    in_new_process("import mvtop; mvtop.Estimator.load('fixtures/tiny')")
    assert not list(tmp_path.iterdir())


def test_more_threads_than_any_machine_has_cores_are_refused():
    for count in (1025, 10**9):
        with pytest.raises(ValueError, match=f"threads: expected 0 to 1024, got {count}; 0 is"):
            mvtop.set_num_threads(count)


def test_a_number_of_threads_holds_in_forked_processes_too(in_new_process):
    script = """
mvtop.set_num_threads(3)
sample(); sample()
assert threads() == before + 3, threads()
child = os.fork()
if child == 0:
    sample()
    os._exit(threads() != 1 + 3)
assert os.waitpid(child, 0)[1] == 0
"""
    in_new_process(THREADS + script)


def test_the_newest_library_of_the_package_is_taken(tmp_path, monkeypatch):
    capi = tmp_path / "onnxruntime" / "capi"
    capi.mkdir(parents=True)
    (capi.parent / "__init__.py").touch()
    for version in ("1.9.0", "1.20.1"):
        (capi / f"libonnxruntime.so.{version}").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "onnxruntime", raising=False)
    monkeypatch.delenv("ORT_DYLIB_PATH", raising=False)
    assert _runtime.library() == capi / "libonnxruntime.so.1.20.1"


def test_interrupt_ends_the_command_at_once():
    # Without a handler of its own, the program dies of the signal, as every command does.
    program = Path(sys.executable).parent / "mvtop-cli"
    read, write = os.pipe()
    # Full, so that the program waits until someone reads.
    os.write(write, bytes(fcntl.fcntl(write, fcntl.F_GETPIPE_SZ)))
    running = subprocess.Popen([program, "--help"], stdout=write)
    with pytest.raises(subprocess.TimeoutExpired):
        running.wait(timeout=1)
    running.send_signal(signal.SIGINT)
    assert running.wait(timeout=60) == -signal.SIGINT
    os.close(write)
    os.close(read)


@pytest.mark.parametrize("closed", [">&-", ">&- 2>&-"])
def test_a_closed_stdout_is_an_error(closed):
    program = Path(sys.executable).parent / "mvtop-cli"
    done = subprocess.run(f"{program} --version {closed}", shell=True, stderr=subprocess.PIPE)
    assert done.returncode == 2
    said = b"error: stdout is closed, expected a stream; fix: >/dev/null\n"
    assert done.stderr == (b"" if "2>" in closed else said)


def test_the_command_answers_like_the_program(cli):
    assert cli("--version").stdout == f"mvtop-cli {mvtop.__version__}\n"
    wrong = cli("infer", "--rig", "none.json", "a.png")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith("error: cannot read none.json")
    assert cli("fly").returncode == 2
    doctor = cli("doctor", "--model", "fixtures/tiny")
    assert doctor.returncode == 0 and "all well" in doctor.stdout, doctor.stdout + doctor.stderr


def test_doctor_says_what_the_library_was_found_by(cli, monkeypatch):
    doctor = ("doctor", "--model", "fixtures/tiny")
    monkeypatch.delenv("ORT_DYLIB_PATH", raising=False)
    library = str(_runtime.library())
    assert "found in    the installed package onnxruntime\n" in cli(*doctor).stdout
    assert "found in    the path given\n" in cli(*doctor, "--ort-lib", library).stdout
    monkeypatch.setenv("ORT_DYLIB_PATH", library)
    assert "found in    ORT_DYLIB_PATH\n" in cli(*doctor).stdout
