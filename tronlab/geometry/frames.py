"""A graph of named frames: say how neighbours lie, ask how any two lie."""

from collections import deque
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.errors import FrameError
from tronlab.geometry.poses import rotation_angle_rad

FRAMES = {
    "trk": "laser tracker",
    "trs": "terrain model, defined by three reflectors",
    "rail": "robot rail",
    "base": "robot base on the rail",
    "flange": "robot flange",
    "tmac": "6-DoF target of the tracker",
    "cam": "camera: x right, y down, z forward",
    "blender_cam": "camera as Blender places it: x right, y up, z backward",
    "board": "calibration board",
    "lamp": "lamp",
}
"""The frames of the laboratory; ``docs/conventions.md`` has their picture."""


class FrameGraph:
    """Rigid transforms between named frames.

    A second way between two frames must agree with the first: a loop that does not close within
    the tolerances is an error the moment it is added, because no answer behind it can be trusted.
    """

    def __init__(self, *, tolerance_m: float = 1e-6, tolerance_rad: float = 1e-6) -> None:
        self._edges: dict[str, dict[str, RigidTransform]] = {}
        self._tolerance_m = tolerance_m
        self._tolerance_rad = tolerance_rad

    @property
    def frames(self) -> tuple[str, ...]:
        """Get the names of all frames added so far, sorted."""
        return tuple(sorted(self._edges))

    def add(self, a: str, b: str, a_from_b: RigidTransform) -> None:
        """Add ``a_from_b``.

        Raises:
            FrameError: ``a`` is ``b``, or another way from b to a gives something else.
        """
        if a == b:
            raise FrameError(f"frame '{a}': cannot be placed relative to itself")
        if a in self._edges and b in self._edges and self._path(a, b):
            self._check_loop(a, b, a_from_b)
        self._edges.setdefault(a, {})[b] = a_from_b
        self._edges.setdefault(b, {})[a] = a_from_b.inv()

    def get(self, a: str, b: str) -> RigidTransform:
        """Give ``a_from_b`` along the shortest way.

        Raises:
            FrameError: One of the frames is unknown, or nothing connects them.
        """
        for name in (a, b):
            if name not in self._edges:
                known = ", ".join(self.frames) or "none"
                raise FrameError(f"frame '{name}': unknown; known frames: {known}")
        path = self._path(a, b)
        if not path:
            raise FrameError(f"no path between frame '{a}' and frame '{b}'")
        a_from_b = RigidTransform.identity()
        for parent, child in pairwise(path):
            a_from_b = a_from_b * self._edges[parent][child]
        return a_from_b

    def _check_loop(self, a: str, b: str, a_from_b: RigidTransform) -> None:
        known = self.get(a, b)
        gap_m = float(np.linalg.norm(known.translation - a_from_b.translation))
        gap_rad = rotation_angle_rad(known, a_from_b)
        if gap_m > self._tolerance_m or gap_rad > self._tolerance_rad:
            loop = " -> ".join([*self._path(a, b), a])
            raise FrameError(
                f"loop {loop} does not close: {gap_m * 1e3:.4g} mm and {gap_rad * 1e3:.4g} mrad"
                f" (allowed {self._tolerance_m * 1e3:.4g} mm, {self._tolerance_rad * 1e3:.4g} mrad)"
            )

    def _path(self, a: str, b: str) -> list[str]:
        """Give the frames from a to b by breadth-first search; empty if there is no way."""
        came_from: dict[str, str | None] = {a: None}
        queue = deque([a])
        while queue:
            frame = queue.popleft()
            if frame == b:
                return _walk_back(came_from, b)
            for neighbour in self._edges[frame]:
                if neighbour not in came_from:
                    came_from[neighbour] = frame
                    queue.append(neighbour)
        return []


def _walk_back(came_from: dict[str, str | None], end: str) -> list[str]:
    path = [end]
    while (previous := came_from[path[-1]]) is not None:
        path.append(previous)
    return path[::-1]
