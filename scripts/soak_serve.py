#!/usr/bin/env python3
"""Many requests to `mvtop-cli serve`, some broken: answers stay right, memory and threads flat.

    make soak-serve                    # 20,000 requests of 4 clients
    make soak-serve REQUESTS=100000

Uses the small network of the tests with given boxes, as what is tested is everything around it.
Some clients send half a body and go, or what is no image. Ends with an error at the first wrong
answer, or where the service has grown. Needs nothing but Python.
"""

import argparse
import http.client
import json
import os
import random
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
TINY = ROOT / "fixtures/tiny"
SAMPLE = TINY / "sample"
CAMERAS = ["cam0", "cam1", "cam2", "cam3"]
BOUNDARY = "frontier"
CLIENTS = 4
WARM = 0.2  # of all requests, before the service is looked at
GROWTH_MB = 16.0  # from then on, at most
GONE, BROKEN = 0.02, 0.02  # shares of clients that go, and of images that are none


def body(cameras: list[str], broken: bool = False) -> bytes:
    """A request of some cameras' images with the sample's boxes."""
    objects = json.loads((SAMPLE / "truth.json").read_text())["objects"]
    boxes = [
        {
            "class": one["class"],
            "boxes": {camera: one["boxes"][camera] for camera in cameras},
        }
        for one in objects
    ]
    parts = [("request", json.dumps({"boxes": boxes}).encode())]
    for camera in cameras:
        image = (SAMPLE / f"{camera}.png").read_bytes()
        parts.append((camera, image[: len(image) // 2] if broken else image))
    text = b""
    for name, content in parts:
        head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"; filename="a"\r\n\r\n'
        text += head.encode() + content + b"\r\n"
    return text + f"--{BOUNDARY}--\r\n".encode()


def status(process: int) -> dict[str, float]:
    """Memory in MB, threads and open files of a process."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    fields = dict(line.split(":", 1) for line in lines)
    return {
        "resident_mb": int(fields["VmRSS"].split()[0]) / 1024,
        "threads": int(fields["Threads"]),
        "files": len(os.listdir(f"/proc/{process}/fd")),
    }


class Soak:
    """Requests by some threads, each checked."""

    def __init__(self, port: int, process: int, count: int):
        self.port, self.process, self.count = port, process, count
        self.bodies = [body(CAMERAS[:views]) for views in range(1, len(CAMERAS) + 1)]
        self.broken = body(CAMERAS[:2], broken=True)
        self.expected = [self.poses(one) for one in self.bodies]
        self.lock, self.done, self.problem = threading.Lock(), 0, None
        self.sent = {"answered": 0, "refused": 0, "gone": 0, "busy": 0}
        self.seen: list[tuple[int, dict]] = []

    def ask(
        self, connection: http.client.HTTPConnection, content: bytes
    ) -> tuple[int, dict]:
        kind = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        connection.request("POST", "/v1/predict", content, kind)
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())

    def connect(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)

    def poses(self, content: bytes) -> list:
        code, document = self.ask(self.connect(), content)
        if code != 200 or not document["objects"]:
            sys.exit(f"error: expected poses, got {code} {document}")
        return [found["T_world_obj"] for found in document["objects"]]

    def next(self) -> int | None:
        """The number of the next request; what the service is like, now and then."""
        with self.lock:
            if self.done >= self.count or self.problem:
                return None
            self.done += 1
            if self.done % max(1, self.count // 20) == 0:
                self.seen.append((self.done, status(self.process)))
            return self.done

    def go(self, content: bytes) -> None:
        """Sends half of a request, and is gone."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=120) as stream:
            head = (
                f"POST /v1/predict HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n"
                f"Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n"
                f"Content-Length: {len(content)}\r\n\r\n"
            )
            stream.sendall(head.encode() + content[: len(content) // 2])

    def one(self, connection, number: int, draw: random.Random) -> str:
        which, chance = number % len(self.bodies), draw.random()
        if chance < GONE:
            self.go(self.bodies[which])
            return "gone"
        if chance < GONE + BROKEN:
            code, document = self.ask(connection, self.broken)
            if code != 400:
                raise RuntimeError(
                    f"expected 400 of a broken image, got {code} {document}"
                )
            return "refused"
        code, document = self.ask(connection, self.bodies[which])
        if code == 503:
            time.sleep(0.02)
            return "busy"
        found = [one["T_world_obj"] for one in document.get("objects", [])]
        if code != 200 or found != self.expected[which]:
            raise RuntimeError(
                f"expected the poses of {which + 1} views, got {code} {document}"
            )
        return "answered"

    def work(self, seed: int) -> None:
        draw, connection = random.Random(seed), self.connect()
        while (number := self.next()) is not None:
            try:
                kind = self.one(connection, number, draw)
            except (
                OSError,
                RuntimeError,
                ValueError,
                http.client.HTTPException,
            ) as error:
                self.problem = f"request {number}: {error!r}"
                return
            with self.lock:
                self.sent[kind] += 1

    def run(self) -> None:
        begun = time.monotonic()
        threads = [
            threading.Thread(target=self.work, args=(seed,)) for seed in range(CLIENTS)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if self.problem:
            sys.exit(f"error: {self.problem}")
        minutes = (time.monotonic() - begun) / 60
        time.sleep(1)  # connections of clients that went are closed
        warm = [seen for number, seen in self.seen if number >= WARM * self.count]
        warm.append(status(self.process))
        print(
            f"{self.count} requests of {CLIENTS} clients, {minutes:.1f} min: {self.sent}"
        )
        for name in warm[0]:
            values = [one[name] for one in warm]
            first, most, last = (
                f"{value:.0f}" for value in (values[0], max(values), values[-1])
            )
            print(
                f"{name}: {first} after {WARM:.0%}, at most {most}, {last} at the end"
            )
        memory = [one["resident_mb"] for one in warm]
        if max(memory) - memory[0] > GROWTH_MB:
            sys.exit(
                f"error: memory: expected growth of {GROWTH_MB} MB at most, got {memory}"
            )
        for name in ("threads", "files"):
            if warm[-1][name] > warm[0][name]:
                sys.exit(f"error: {name}: expected no more at the end, got {warm}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cli", default=str(ROOT / "target/release/mvtop-cli"))
    parser.add_argument("--requests", type=int, default=20_000)
    args = parser.parse_args()
    command = [
        args.cli,
        "serve",
        "--model",
        TINY,
        "--port",
        "0",
        "--rig",
        SAMPLE / "rig.json",
    ]
    environment = {k: v for k, v in os.environ.items() if k != "MVTOP_TOKEN"}
    service = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=environment
    )
    port = None
    for line in service.stderr:
        if line.startswith("listening on "):
            port = int(line.rstrip("/\n").rsplit(":", 1)[1])
        if line.strip() == "ready":
            break
    if port is None or service.poll() is not None:
        sys.exit(f"error: the service did not start: {' '.join(map(str, command))}")
    threading.Thread(target=lambda: [None for _ in service.stderr], daemon=True).start()
    try:
        Soak(port, service.pid, args.requests).run()
    finally:
        service.terminate()
        code = service.wait()
    if code:
        sys.exit(f"error: the service ended with code {code}")


if __name__ == "__main__":
    main()
