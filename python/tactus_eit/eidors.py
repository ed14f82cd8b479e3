"""Meshes and protocols from EIDORS, as ``scipy.io.loadmat`` reads them.

In MATLAB or Octave: ``save('-v7', 'tank.mat', 'fmdl', 'vh', 'vi')``. All forms of structures that loadmat returns are accepted.
Numbers of nodes and electrodes, which EIDORS counts from 1, are counted from 0 here. Lengths and impedances stay in the units of
the file: with nodes in m and z_contact in ohm m, conductances are in S per square. Models of volumes are not accepted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .triangulation import tidied

# currents and gains that differ by less are equal but for rounding
_ROUNDING = 1e-9
# amperes in the units of a stimulation
_AMPERES = {"amp": 1.0, "a": 1.0, "ma": 1e-3}


def forward(model: Any) -> _native.Forward:
    """The Forward model of an EIDORS fwd_model: nodes, elems, electrode (nodes, z_contact) and stimulation."""
    made = mesh(model)
    contact = []
    for number, one in enumerate(_electrodes(model), 1):
        name = f"model.electrode({number}).z_contact"
        value = np.ravel(_numbers(_field(one, "z_contact", f"model.electrode({number})"), name))
        if len(value) != 1:
            raise ValueError(f"argument 'model': {name} has {len(value)} values; expected one, in ohm m")
        contact.append(value[0])
    return _native.Forward(made, protocol(model), contact)


def mesh(model: Any) -> _native.Mesh:
    """The Mesh of an EIDORS fwd_model of triangles; an electrode covers the boundary edges between its nodes."""
    nodes = _numbers(_field(model, "nodes", "model"), "model.nodes")
    elems = _numbers(_field(model, "elems", "model"), "model.elems")
    if nodes.ndim != 2 or nodes.shape[1] != 2:
        raise ValueError(f"argument 'model': nodes has shape {nodes.shape}; expected (nodes, 2), the engine has no volumes")
    if elems.ndim != 2 or elems.shape[1] != 3 or not len(elems):
        raise ValueError(f"argument 'model': elems has shape {elems.shape}; expected triangles, shape (triangles, 3)")
    triangles = _from_one(elems, len(nodes), "model.elems")
    kept, tidy, number = tidied(nodes, triangles)
    # a side of one triangle only is an edge of the outline
    sides = tidy[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = sides.min(axis=1) * len(kept) + sides.max(axis=1)
    _, first, counts = np.unique(keys, return_index=True, return_counts=True)
    outline = sides[first[counts == 1]]
    edges = []
    for at, electrode in enumerate(_electrodes(model), 1):
        name = f"model.electrode({at}).nodes"
        own = _from_one(np.ravel(_numbers(_field(electrode, "nodes", f"model.electrode({at})"), name)), len(nodes), name)
        covered = outline[np.isin(outline, number[own]).all(axis=1)]
        if not len(covered):
            raise ValueError(
                f"argument 'model': electrode({at}) covers no edge of the outline with its {len(own)} nodes; expected an electrode of "
                "the complete electrode model, with two neighbouring nodes or more"
            )
        edges.append(covered)
    return _native.Mesh(kept, tidy, edges)


def protocol(model: Any) -> _native.Protocol:
    """The Protocol of an EIDORS fwd_model, from its stimulation: pairs that are driven, and pairs that are measured."""
    inject, measure, electrodes, _ = _patterns(model)
    return _native.Protocol.from_pairs(inject, measure, electrodes)


def current(model: Any) -> float:
    """The current of the stimulation, A: for ``OneStep(..., current=)``."""
    return _patterns(model)[3]


def _patterns(model: Any) -> tuple[NDArray[np.int64], NDArray[np.int64], int, float]:
    inject, measure, currents = [], [], []
    electrodes = 0
    for number, one in enumerate(_each(_field(model, "stimulation", "model"), "model.stimulation"), 1):
        name = f"model.stimulation({number})"
        driven = _dense(_field(one, "stim_pattern", name), f"{name}.stim_pattern").reshape(1, -1)
        pair, amperes = _pair(driven[0], f"{name}.stim_pattern")
        rows = _dense(_field(one, "meas_pattern", name), f"{name}.meas_pattern")
        electrodes = driven.shape[1]
        if rows.ndim != 2 or rows.shape[1] != electrodes:
            raise ValueError(f"argument 'model': {name}.meas_pattern has shape {rows.shape}; expected (readings, {electrodes})")
        for row in rows:
            sensed, gain = _pair(row, f"{name}.meas_pattern")
            if abs(gain - 1.0) > _ROUNDING:
                raise ValueError(f"argument 'model': {name}.meas_pattern has a gain of {gain}; expected 1 and -1")
            inject.append(pair)
            measure.append(sensed)
        currents.append(_scale(one, name) * amperes)
    if not inject:
        raise ValueError("argument 'model': its stimulation has no readings; expected what mk_stim_patterns returns")
    if max(currents) - min(currents) > _ROUNDING * max(currents):
        raise ValueError(
            f"argument 'model': the currents of its stimulation are {min(currents)} to {max(currents)} A; expected one for all: divide the "
            "readings of each by its current, and set all to 1"
        )
    return np.array(inject), np.array(measure), electrodes, currents[0]


def _scale(stimulation: Any, name: str) -> float:
    """Amperes in the unit of a stimulation's current; without a unit it is in A."""
    try:
        given = _field(stimulation, "stimulation", name)
    except TypeError:
        return 1.0
    unit = np.ravel(given)
    text = str(unit[0]) if unit.size == 1 else ""
    if text.lower() not in _AMPERES:
        raise ValueError(f"argument 'model': {name}.stimulation is {text or given!r}; expected 'Amp' or 'mA'")
    return _AMPERES[text.lower()]


def _pair(pattern: NDArray[np.float64], name: str) -> tuple[list[int], float]:
    """Plus and minus of a pattern with two entries that cancel, and their size."""
    at = np.flatnonzero(pattern)
    if len(at) != 2 or abs(pattern.sum()) > _ROUNDING * np.abs(pattern).max():
        raise ValueError(f"argument 'model': {name} names {len(at)} electrodes; expected two, with opposite values")
    plus, minus = at if pattern[at[0]] > 0.0 else at[::-1]
    return [int(plus), int(minus)], float(pattern[plus])


def _electrodes(model: Any) -> list[Any]:
    return _each(_field(model, "electrode", "model"), "model.electrode")


def _field(structure: Any, field: str, name: str) -> Any:
    """A field of a structure in any of the forms of loadmat: dict, record, or object with attributes."""
    if isinstance(structure, np.ndarray) and structure.size == 1:
        structure = structure.reshape(-1)[0]
    if isinstance(structure, dict) and field in structure:
        return structure[field]
    if isinstance(structure, np.void) and field in (structure.dtype.names or ()):
        return structure[field]
    if hasattr(structure, "_fieldnames") and hasattr(structure, field):
        return getattr(structure, field)
    raise TypeError(
        f"argument 'model': {name} has no field {field}; expected a fwd_model of EIDORS as scipy.io.loadmat(...)['fmdl'] returns it"
    )


def _each(structures: Any, name: str) -> list[Any]:
    """The elements of an array of structures; one structure is an array of one."""
    if isinstance(structures, np.ndarray):
        return list(structures.reshape(-1))
    if isinstance(structures, (list, tuple)):
        return list(structures)
    if isinstance(structures, dict) or hasattr(structures, "_fieldnames"):
        return [structures]
    raise TypeError(f"argument 'model': {name} is a {type(structures).__name__}; expected an array of structures")


def _dense(given: Any, name: str) -> NDArray[np.float64]:
    return _numbers(given.toarray() if hasattr(given, "toarray") else given, name)


def _numbers(given: Any, name: str) -> NDArray[np.float64]:
    array = np.asarray(given)
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise ValueError(f"argument 'model': {name} has values that are no finite real numbers")
    return array.astype(np.float64)


def _from_one(numbers: NDArray[np.float64], count: int, name: str) -> NDArray[np.int64]:
    if numbers.size and not (numbers.min() >= 1 and numbers.max() <= count and (numbers % 1 == 0).all()):
        raise ValueError(f"argument 'model': {name} names node {numbers.min():g} or {numbers.max():g}; expected whole numbers from 1 to {count}")
    return numbers.astype(np.int64) - 1
