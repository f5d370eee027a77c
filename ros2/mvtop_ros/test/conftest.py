"""Examples as messages, and nodes as processes of their own."""

import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

# Nothing of this machine's other ROS is met; before anything of ROS is imported.
os.environ.setdefault("ROS_DOMAIN_ID", str(10 + os.getpid() % 90))
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import numpy as np
import pytest
import rclpy
from PIL import Image as Picture
from rclpy.executors import SingleThreadedExecutor

import mvtop

ROOT = Path(__file__).resolve().parents[3]
warnings.simplefilter("ignore", mvtop.MvtopWarning)


class Example:
    """A shipped scene: its rig, RGB arrays by camera, and true poses by class."""

    def __init__(self, name):
        import json

        self.folder = ROOT / "examples" / name
        self.model = ROOT / "models" / name
        self.rig = mvtop.Rig.load(self.folder / "rig.json")
        self.images, self.files = {}, {}
        for camera in self.rig.cameras:
            (self.files[camera.id],) = [
                path
                for path in self.folder.glob(f"{camera.id}.*")
                if path.suffix in (".png", ".jpg")
            ]
            self.images[camera.id] = np.asarray(Picture.open(self.files[camera.id]).convert("RGB"))
        truth = json.loads((self.folder / "truth.json").read_text())["objects"]
        self.truth = {one["class"]: np.array(one["T_world_obj"]) for one in truth}


@pytest.fixture(scope="session")
def parts():
    return Example("ycbv4")


@pytest.fixture(scope="session")
def ball():
    return Example("mvball")


@pytest.fixture(scope="session")
def ros():
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Client:
    """A node of the test's own, and an executor that turns it."""

    def __init__(self, name):
        self.node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, done, seconds=60.0):
        """Turns until something is so; fails where it is not in time."""
        end = time.monotonic() + seconds
        while not (value := done()):
            assert time.monotonic() < end, "expected it in time"
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def turn(self, seconds):
        """Turns for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def service(self, kind, name):
        """A client of a service that is there, and whose server knows of the client."""
        made = self.node.create_client(kind, name)
        assert made.wait_for_service(timeout_sec=60)
        self.turn(1.0)  # else a first answer is lost at times
        return made

    def call(self, client, request, seconds=60.0):
        """The answer of a service."""
        return self.answer(client.call_async(request), seconds)

    def answer(self, future, seconds=60.0):
        self.until(future.done, seconds)
        return future.result()

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def client(ros):
    made = Client("test_client")
    yield made
    made.close()


@pytest.fixture(scope="module")
def run():
    """Starts `python -m mvtop_ros.MODULE` with parameters; ends it afterwards."""
    processes = []

    def start(module, name=None, **parameters):
        arguments = [sys.executable, "-m", f"mvtop_ros.{module}", "--ros-args"]
        arguments += [] if name is None else ["-r", f"__node:={name}"]
        for key, value in parameters.items():
            arguments += ["-p", f"{key}:={value}"]
        process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
        process.stdout.close()


def error_of(world_from_obj, truth):
    """Degrees and metres between two poses."""
    turn = world_from_obj[:3, :3].T @ truth[:3, :3]
    degrees = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return degrees, np.linalg.norm(world_from_obj[:3, 3] - truth[:3, 3])
