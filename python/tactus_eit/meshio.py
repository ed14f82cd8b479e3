"""Meshes that the package meshio has read, from gmsh and many other programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .triangulation import tidied


def mesh(read: Any, electrodes: Sequence[str]) -> _native.Mesh:
    """The Mesh of what ``meshio.read`` returned: its triangles, positions in m in the plane z = 0.

    electrodes: for each electrode, in order, the name of its lines on the boundary: a physical group of gmsh, or a set of cells.

    mesh = tactus_eit.meshio.mesh(meshio.read("tank.msh"), [f"electrode {number}" for number in range(1, 17)])
    """
    if not hasattr(read, "cells_dict") or not hasattr(read, "points"):
        raise TypeError(f"argument 'read': it is a {type(read).__name__}; expected what meshio.read(file) returned")
    if "triangle" not in read.cells_dict:
        raise ValueError(f"argument 'read': it has {', '.join(read.cells_dict) or 'no cells'}; expected triangles")
    points = np.asarray(read.points, dtype=np.float64)
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points[:, :2]):
        raise ValueError("argument 'read': its nodes are not in a plane z = const; the engine has no volumes")
    nodes, triangles, number = tidied(points[:, :2], np.asarray(read.cells_dict["triangle"], dtype=np.int64))
    if isinstance(electrodes, str) or not all(isinstance(name, str) for name in electrodes):
        raise TypeError("argument 'electrodes': expected a list of names of lines, one for each electrode")
    return _native.Mesh(nodes, triangles, [number[_lines(read, name)] for name in electrodes])


def _lines(read: Any, name: str) -> NDArray[np.int64]:
    """Both nodes of each line with a name."""
    lines = np.asarray(read.cells_dict.get("line", np.empty((0, 2))), dtype=np.int64)
    tags = read.cell_data_dict.get("gmsh:physical", {}).get("line")
    if name in read.field_data and tags is not None:
        chosen = np.flatnonzero(np.asarray(tags) == read.field_data[name][0])
    else:
        chosen = np.asarray(read.cell_sets_dict.get(name, {}).get("line", []), dtype=np.int64)
    if not len(chosen):
        names = sorted({*read.field_data, *(key for key in read.cell_sets_dict if not key.startswith("gmsh:"))})
        raise ValueError(f"argument 'electrodes': no line has the name {name!r}; the file has {', '.join(map(repr, names)) or 'no names'}")
    found: NDArray[np.int64] = lines[chosen]
    return found
