"""Triangles from other programs as the engine takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def tidied(
    nodes: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Triangles counter-clockwise, and nodes without those of no triangle.

    nodes: shape (nodes, 2). triangles: shape (triangles, 3). Returns nodes, triangles, and the new number of each node, -1 where it has none.
    """
    (p, q, r) = nodes[triangles].transpose(1, 0, 2)
    turned = (q - p)[:, 0] * (r - p)[:, 1] < (q - p)[:, 1] * (r - p)[:, 0]
    triangles = np.where(turned[:, None], triangles[:, ::-1], triangles)
    used, inverse = np.unique(triangles, return_inverse=True)
    number = np.full(len(nodes), -1)
    number[used] = np.arange(len(used))
    return nodes[used], inverse.reshape(-1, 3), number
