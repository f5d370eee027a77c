"""Where frames are, from the messages on /tf and /tf_static."""

import threading
from collections import deque

import numpy as np

from mvtop_ros.transforms import of_transform, quaternion_of, rotation_of

# Deepest tree that is followed; a loop is deeper.
_DEEPEST = 100
_KEPT_S = 10.0


class Frames:
    """Keeps the transforms of the last seconds. Threads may share it."""

    def __init__(self, tolerance_s):
        """- tolerance_s: how much older than an image its transform may be"""
        self._tolerance_s = tolerance_s
        self._links = {}  # by child: parent, whether static, deque of (time, parent_from_child)
        self._lock = threading.Lock()

    def add(self, message, is_static):
        """Takes over a `TFMessage`; returns what was wrong with it, a sentence each."""
        wrong = []
        for one in message.transforms:
            child, parent = _name(one.child_frame_id), _name(one.header.frame_id)
            try:
                parent_from_child = of_transform(one.transform)
            except ValueError as problem:
                wrong.append(f"transform from {child} to {parent}: {problem}")
                continue
            stamp_s = one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec
            with self._lock:
                self._take(child, parent, is_static, stamp_s, parent_from_child)
        return wrong

    def _take(self, child, parent, is_static, stamp_s, parent_from_child):
        known = self._links.get(child)
        if known is None or known[0] != parent or is_static or known[1]:
            known = self._links[child] = (parent, is_static, deque())
        history = known[2]
        if history and stamp_s <= history[-1][0]:
            if stamp_s > history[-1][0] - _KEPT_S:
                return  # late, or twice
            history.clear()  # time has begun anew
        history.append((stamp_s, parent_from_child))
        while history[-1][0] - history[0][0] > _KEPT_S:
            history.popleft()

    def lookup(self, target, source, stamp_s):
        """The matrix `target_from_source` at a time, seconds.

        Raises `LookupError` with a sentence where it is not known.
        """
        with self._lock:
            from_source = self._to_root(_name(source), stamp_s)
            from_target = self._to_root(_name(target), stamp_s)
        for frame, frame_from_source in from_source.items():
            if frame in from_target:
                return np.linalg.inv(from_target[frame]) @ frame_from_source
        raise LookupError(
            f"expected transforms that link frame `{source}` to `{target}`, got none on /tf or "
            "/tf_static; publish them, or give a rig file"
        )

    def _to_root(self, frame, stamp_s):
        """By each frame from this one to the root: `frame_from_this`."""
        found = {frame: np.eye(4)}
        for _ in range(_DEEPEST):
            if frame not in self._links:
                return found
            parent, is_static, history = self._links[frame]
            step = history[-1][1] if is_static else self._at(frame, history, stamp_s)
            found[parent] = step @ found[frame]
            frame = parent
        raise LookupError(f"expected a tree of frames, got a loop at `{frame}`; correct /tf")

    def _at(self, frame, history, stamp_s):
        after = next((i for i, (time, _) in enumerate(history) if time >= stamp_s), None)
        if after is None or after == 0:
            time, pose = history[-1 if after is None else 0]
            if abs(stamp_s - time) > self._tolerance_s:
                raise LookupError(
                    f"transform of frame `{frame}`: expected one within {self._tolerance_s} s of "
                    f"the images, the nearest is {abs(stamp_s - time):.3f} s off"
                )
            return pose
        (t0, pose0), (t1, pose1) = history[after - 1], history[after]
        return _between(pose0, pose1, (stamp_s - t0) / (t1 - t0))


def _between(pose0, pose1, share):
    """The pose at a share of the way."""
    q0, q1 = quaternion_of(pose0[:3, :3]), quaternion_of(pose1[:3, :3])
    cosine = float(q0 @ q1)
    if cosine < 0:
        q1, cosine = -q1, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        q = q0
    else:
        q = (np.sin((1 - share) * angle) * q0 + np.sin(share * angle) * q1) / np.sin(angle)
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(q)
    pose[:3, 3] = (1 - share) * pose0[:3, 3] + share * pose1[:3, 3]
    return pose


def _name(frame):
    """ROS 1 wrote names with a slash."""
    return frame.removeprefix("/")
