"""Poses for a robot's program, by the line protocol of `mvtop-cli serve --line-port`.

Plain Python, nothing to install:

    python robot_client.py --port 9000 FIND most=1 frame=base unit=mm min_confidence=0.9

`docs/how-to/serve.md` describes the lines.
"""

import argparse
import socket
import sys
from dataclasses import dataclass


class Refused(Exception):
    """What the service answers instead of poses: a code for programs, and a sentence."""

    def __init__(self, code: str, sentence: str):
        super().__init__(sentence)
        self.code = code


@dataclass
class Pose:
    """One object.

    - confidence: probability that the pose is right; None where the model does not say
    - verdict: accept, reject or need_another_view; None where no confidence was asked for
    - place: x, y, z of its origin in the frame and unit that were asked for
    - turn: w, x, y, z of a unit quaternion, or as `rotation` was asked for
    - id: number of the object over time; None where no `stream` was named
    """

    name: str
    confidence: float | None
    verdict: str | None
    place: tuple[float, ...]
    turn: tuple[float, ...]
    id: int | None = None


class Robot:
    """A connection to the service.

    - timeout: seconds to wait for an answer; then TimeoutError is raised
    """

    def __init__(self, host="127.0.0.1", port=9000, token=None, timeout=60.0):
        self.socket = socket.create_connection((host, port), timeout)
        self.lines = self.socket.makefile("r", encoding="utf-8")
        if token:
            self.ask(f"TOKEN {token}")

    def ask(self, line: str) -> list[str]:
        """Sends a line, and returns those of the answer.

        Raises Refused, or OSError where there is none.
        """
        self.socket.sendall(line.encode() + b"\n")
        answer = []
        while (got := self.lines.readline().rstrip("\n")) != "END":
            if not got:
                raise ConnectionError("the service has closed the connection")
            answer.append(got)
        if answer[0].startswith("ERROR "):
            raise Refused(*answer[0].split(" ", 2)[1:])
        return answer

    def poses(self, line="FIND") -> list[Pose]:
        """The poses that FIND or LAST gives, with settings as in `FIND most=1 frame=base`."""
        found = []
        for words in (answer.split(" ") for answer in self.ask(line)):
            if words[0] != "POSE":
                continue
            known = words.pop().removeprefix("id=") if words[-1].startswith("id=") else None
            numbers = tuple(float(word) for word in words[5:])
            confidence = None if words[3] == "-" else float(words[3])
            verdict = None if words[4] == "-" else words[4]
            number = None if known is None else int(known)
            found.append(Pose(words[2], confidence, verdict, numbers[:3], numbers[3:], number))
        return found

    def close(self):
        self.lines.close()
        self.socket.close()


def main() -> int:
    parser = argparse.ArgumentParser(description="Asks for poses, and prints them.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9000)
    parser.add_argument("--token")
    parser.add_argument("line", nargs="+", help="FIND or LAST, and settings")
    args = parser.parse_args()
    robot = Robot(args.host, args.port, args.token)
    try:
        for pose in robot.poses(" ".join(args.line)):
            print(pose)
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finally:
        robot.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
