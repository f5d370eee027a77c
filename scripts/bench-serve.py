#!/usr/bin/env python3
"""Load on `mvtop-cli serve`: latency, throughput against the library alone, and memory.

    scripts/bench-serve.py --cli target/release/mvtop-cli --seconds 60 --clients 1 2 4 8

Clients send the example again and again, each exposure either with both images or with one of
them; every answer must be that of the same images sent alone, and carry the id of its request.
Needs nothing but Python.
"""

import argparse
import http.client
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples/mvball"
BOUNDARY = "frontier"
# Predictions of the library alone: enough that its start does not count.
ALONE = 40


def body(cameras: list[str]) -> bytes:
    parts = []
    for camera in cameras:
        name = f'Content-Disposition: form-data; name="{camera}"; filename="a"'
        head = f"--{BOUNDARY}\r\n{name}\r\n\r\n"
        parts.append(head.encode() + (EXAMPLE / f"{camera}.png").read_bytes() + b"\r\n")
    return b"".join(parts) + f"--{BOUNDARY}--\r\n".encode()


BODIES = [body(["cam0", "cam1"]), body(["cam0"])]


class Client:
    """One connection that is kept."""

    def __init__(self, port: int):
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)

    def ask(self, which: int, request_id: str) -> tuple[int, dict, float]:
        """Status, document and seconds."""
        headers = {
            "Content-Type": f"multipart/form-data; boundary={BOUNDARY}",
            "X-Request-Id": request_id,
        }
        began = time.perf_counter()
        self.connection.request("POST", "/v1/predict", BODIES[which], headers)
        answer = self.connection.getresponse()
        text = answer.read()
        took = time.perf_counter() - began
        if answer.headers["X-Request-Id"] != request_id:
            raise RuntimeError(f"expected the answer to {request_id}, got that to another request")
        return answer.status, json.loads(text), took


def poses(document: dict) -> list:
    return [found["T_world_obj"] for found in document["objects"]]


def memory_mib(process: int) -> float:
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))


def percentile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def load(port: int, process: int, clients: int, seconds: float, expected: list) -> dict:
    """What so many clients see in that time; both kinds of exposures in turn."""
    times: list[float] = []
    inside: list[float] = []
    busy = [0]
    problems: list[str] = []
    end = time.monotonic() + seconds

    def work(number: int):
        client = Client(port)
        count = number  # so that clients send different images at a time
        try:
            while time.monotonic() < end:
                which = count % 2
                status, document, took = client.ask(which, f"{number}-{count}")
                count += 1
                if status == 503:
                    busy[0] += 1
                    time.sleep(0.05)
                    continue
                if status != 200 or poses(document) != expected[which]:
                    problems.append(f"{status}: {str(document)[:300]}")
                    return
                times.append(took)
                inside.append(document["timings_ms"]["total"] / 1e3)
        except (OSError, RuntimeError, http.client.HTTPException) as error:
            problems.append(repr(error))

    began = time.monotonic()
    threads = [threading.Thread(target=work, args=(number,)) for number in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if problems or not times:
        sys.exit(f"error: expected right answers alone, got {problems[:3]}")
    overhead = [took - predicted for took, predicted in zip(times, inside, strict=True)]
    return {
        "clients": clients,
        "answers": len(times),
        "busy": busy[0],
        "per_s": len(times) / (time.monotonic() - began),
        "p50_ms": 1e3 * percentile(times, 0.5),
        "p95_ms": 1e3 * percentile(times, 0.95),
        "p99_ms": 1e3 * percentile(times, 0.99),
        "predict_p50_ms": 1e3 * percentile(inside, 0.5),
        "beside_p50_ms": 1e3 * percentile(overhead, 0.5),
        "memory_mib": memory_mib(process),
    }


def alone(cli: str, model: str) -> float:
    """Exposures a second of the library alone, images read from files, as many of both kinds."""

    def run(cameras: int, count: int) -> float:
        with tempfile.TemporaryDirectory() as folder:
            for number in range(count):
                sample = Path(folder) / f"{number:04}"
                shutil.copytree(EXAMPLE, sample)
                if cameras == 1:
                    (sample / "cam1.png").unlink()
                    rig = json.loads((sample / "rig.json").read_text())
                    rig["cameras"] = rig["cameras"][:1]
                    (sample / "rig.json").write_text(json.dumps(rig))
            command = [cli, "eval", "samples", folder, "--model", model, "--json"]
            began = time.monotonic()
            subprocess.run(command, check=True, capture_output=True)
            return time.monotonic() - began

    # Their difference is without the start.
    seconds = sum(run(cameras, ALONE // 2 + 2) - run(cameras, 2) for cameras in (1, 2))
    return ALONE / seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cli", default=str(ROOT / "target/release/mvtop-cli"))
    parser.add_argument("--model", default=str(ROOT / "models/mvball"))
    parser.add_argument("--seconds", type=float, default=60, help="of each number of clients")
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--out", type=Path, help="JSON with all figures")
    args = parser.parse_args()
    rate = alone(args.cli, args.model)
    command = [args.cli, "serve", "--model", args.model, "--port", "0"]
    command += ["--rig", str(EXAMPLE / "rig.json")]
    environment = {k: v for k, v in os.environ.items() if k != "MVTOP_TOKEN"}
    began = time.monotonic()
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    port = 0
    for line in process.stderr:
        if line.startswith("listening on "):
            port = int(line.rstrip("/\n").rsplit(":", 1)[1])
        if line.strip() == "ready":
            break
    ready_s = time.monotonic() - began
    threading.Thread(target=lambda: [None for _ in process.stderr], daemon=True).start()
    try:
        client = Client(port)
        expected = [poses(client.ask(which, "first")[1]) for which in (0, 1)]
        rows = [load(port, process.pid, n, args.seconds, expected) for n in args.clients]
    finally:
        process.terminate()
        code = process.wait()
    print(f"library alone {rate:.2f} exposures/s; ready after {ready_s:.2f} s; exit code {code}")
    print(" | ".join(rows[0]))
    for row in rows:
        cells = [f"{x:.1f}" if isinstance(x, float) else str(x) for x in row.values()]
        print(" | ".join(cells))
    if args.out:
        figures = {"alone_per_s": rate, "ready_s": ready_s, "load": rows}
        args.out.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
