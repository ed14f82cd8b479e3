"""The engine for programs written for pyEIT: its mesh and protocol objects are taken as they are.

In a program that has ``import pyeit.eit.jac as jac``, change that line to ``import tactus_eit.pyeit as jac``.

An electrode of pyEIT is a point. Here it is a quarter of each boundary edge at that point, with a contact impedance (complete
electrode model); the triangles at these edges are divided for that, and results are given for the triangles of pyEIT. Lengths
and conductances are in the units of the mesh. Complex conductances, meshes of tetrahedra, and the classes BP, GREIT and SVD are
not supported.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

# share of a boundary edge that belongs to the electrode at its end
_SHARE = 0.25


class EITForward:
    """Forward model and Jacobian on a PyEITMesh with a PyEITProtocol.

    contact: contact impedance in units of 1 / conductance times length: a number, or shape (electrodes,); by default as large
        as the sheet's resistance per square times the length of the electrode.
    """

    def __init__(self, mesh: Any, protocol: Any, *, contact: ArrayLike | None = None) -> None:
        self.mesh = mesh
        self.protocol = protocol
        nodes, triangles, electrodes, self._parents = _cut(mesh)
        self._triangles = len(mesh.element)
        made = _native.Mesh(nodes, triangles, electrodes)
        if contact is None:
            contact = made.electrode_lengths / self._conductance(mesh.perm).mean()
        self.forward = _native.Forward(made, _protocol(protocol, len(electrodes)), contact)

    def solve_eit(self, perm: Any = None) -> NDArray[np.float64]:
        """Readings for a current of 1: shape (readings,). perm: conductance, a number or shape (triangles,)."""
        return self.forward.solve(self._of_parts(perm))

    def compute_jac(self, perm: Any = None, normalize: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Jacobian with the sign of pyEIT (minus the derivative of the readings), shape (readings, triangles), and readings.

        normalize: divides each row by the magnitude of its reading.
        """
        conductance = self._of_parts(perm)
        volts = self.forward.solve(conductance)
        derivative = self.forward.jacobian(conductance)
        jacobian = derivative[:, : self._triangles]
        # conductances next to the limits of a double overflow; setup refuses them
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for part, parent in enumerate(self._parents[self._triangles :], self._triangles):
                jacobian[:, parent] += derivative[:, part]
            np.negative(jacobian, out=jacobian)
            if normalize:
                jacobian /= np.abs(volts)[:, np.newaxis]
        return jacobian, volts

    def _conductance(self, perm: Any) -> NDArray[np.float64]:
        given = self.mesh.perm if perm is None else perm
        values = np.asarray(1.0 if given is None else given)
        if values.dtype.kind not in "fiu":
            raise TypeError(f"argument 'perm': dtype {values.dtype}; expected real conductances, the engine has no complex ones")
        if values.shape not in ((), (self._triangles,)):
            raise ValueError(f"argument 'perm': its shape is {values.shape}; expected a number, or shape ({self._triangles},)")
        conductance = np.broadcast_to(values, (self._triangles,)).astype(np.float64)
        if not (np.isfinite(conductance).all() and conductance.min() >= 0.0 and conductance.max() > 0.0):
            raise ValueError("argument 'perm': a value is negative or not finite, or all are 0; expected conductances above 0")
        return conductance

    def _of_parts(self, perm: Any) -> NDArray[np.float64]:
        return self._conductance(perm)[self._parents]


def forward(mesh: Any, protocol: Any, *, contact: ArrayLike | None = None) -> _native.Forward:
    """The forward model of a PyEITMesh with a PyEITProtocol, for OneStep and the other methods. contact: as in EITForward.

    Its ``mesh`` has more triangles than pyEIT's: draw maps on that one. Its ``protocol`` has pyEIT's pairs, a row for each reading.
    """
    return EITForward(mesh, protocol, contact=contact).forward


class JAC:
    """Dynamic imaging with the Jacobian, as the class of this name in pyEIT.

    mesh: a PyEITMesh of triangles. protocol: a PyEITProtocol. contact: as in EITForward.

    >>> import numpy, tactus_eit.pyeit
    >>> from types import SimpleNamespace
    >>> turn = 2 * numpy.pi * numpy.arange(24) / 24
    >>> node = numpy.vstack([[[0.0, 0.0]], numpy.c_[numpy.cos(turn), numpy.sin(turn)]])
    >>> element = numpy.array([[0, 1 + k, 1 + (k + 1) % 24] for k in range(24)])
    >>> mesh = SimpleNamespace(node=node, element=element, el_pos=numpy.arange(1, 25, 3), perm=1.0)
    >>> pairs = numpy.array([[k, (k + 1) % 8] for k in range(8)])
    >>> others = numpy.array([[[(k + m + 1) % 8, (k + m) % 8] for m in range(2, 7)] for k in range(8)])
    >>> protocol = SimpleNamespace(ex_mat=pairs, meas_mat=others)
    >>> jac = tactus_eit.pyeit.JAC(mesh, protocol).setup(p=0.5, lamb=0.01, method="kotre")
    >>> jac.solve(jac.v0, jac.v0, normalize=True).shape
    (24,)
    """

    def __init__(self, mesh: Any, protocol: Any, *, contact: ArrayLike | None = None) -> None:
        self.fwd = EITForward(mesh, protocol, contact=contact)
        self.mesh = mesh
        self.is_ready = False

    def setup(
        self,
        p: float = 0.20,
        lamb: float = 0.001,
        method: str = "kotre",
        perm: Any = None,
        jac_normalized: bool = False,
    ) -> JAC:
        """Prepares the matrix H = (J'J + lamb R)^-1 J'. Returns self.

        method: "kotre", R = diag(J'J)^p; "lm", R = diag(J'J); "dgn", R = 1. perm: conductance of J. jac_normalized: each row of
        J divided by the magnitude of its reading.
        """
        if method not in ("kotre", "lm", "dgn"):
            raise ValueError(f"argument 'method': it is {method!r}; expected one of 'kotre', 'lm', 'dgn'")
        lamb = _number("lamb", lamb, "a number above 0")
        if lamb <= 0.0:
            raise ValueError(f"argument 'lamb': it is {lamb}; expected a number above 0")
        p = _number("p", p, "a number, usually 0 to 1")
        self.J, self.v0 = self.fwd.compute_jac(perm, jac_normalized)
        with np.errstate(all="ignore"):
            squares = np.einsum("ij,ij->j", self.J, self.J)
            squares = np.maximum(squares, 1e-12 * squares.max())
            weights = {"kotre": squares**p, "lm": squares, "dgn": np.ones_like(squares)}[method]
            # the same as the formula above, with an inverse of readings x readings in place of triangles x triangles
            spread = self.J / weights
            system = spread @ self.J.T
        if not np.isfinite(system).all():
            raise ValueError(f"arguments 'perm' and 'p': with p = {p} the system is beyond the numbers of a double; expected less extreme ones")
        system[np.diag_indices_from(system)] += lamb
        self.H = np.linalg.solve(system, spread).T
        self.params = {"p": p, "lamb": lamb, "method": method, "jac_normalize": jac_normalized}
        self.is_ready = True
        return self

    def solve(
        self, v1: ArrayLike, v0: ArrayLike, normalize: bool = False, log_scale: bool = False
    ) -> NDArray[np.float64]:
        """Change of conductance of each triangle: shape (triangles,), or (triangles, frames).

        v1: frame, shape (readings,), or (frames, readings). v0: reference frame, shape (readings,). normalize: divides v1 - v0
        by the magnitude of v0. log_scale: exp(change) - 1.
        """
        if not self.is_ready:
            raise RuntimeError("this JAC is not set up: call setup(p=, lamb=, method=) before solve")
        readings = len(self.v0)
        frame = self._volts("v1", v1, f"shape ({readings},) or (frames, {readings})")
        reference = self._volts("v0", v0, f"shape ({readings},)")
        if reference.ndim != 1:
            raise ValueError(f"argument 'v0': its shape is {reference.shape}; expected shape ({readings},)")
        change = frame - reference
        if normalize:
            if not reference.all():
                raise ValueError("argument 'v0': a reading is 0 and cannot normalise; expected signed voltages other than 0")
            change = change / np.abs(reference)
        solved: NDArray[np.float64] = -(self.H @ change.T)
        return np.exp(solved) - 1.0 if log_scale else solved

    def _volts(self, name: str, volts: ArrayLike, shape: str) -> NDArray[np.float64]:
        rows = _native.as_frames(volts, name, len(self.v0), True)
        if not np.isfinite(rows).all():
            raise ValueError(
                f"argument '{name}': a reading is missing (nan), and JAC needs all; expected {shape} of signed voltages; "
                "OneStep(tactus_eit.pyeit.forward(mesh, protocol), missing='mask') accepts missing readings"
            )
        return rows[0] if np.ndim(volts) == 1 else rows


def _number(name: str, value: object, expected: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"argument '{name}': it is a {type(value).__name__}; expected {expected}")
    number = float(value)
    if not abs(number) < np.inf:
        raise ValueError(f"argument '{name}': it is {value}; expected {expected}")
    return number


def _protocol(protocol: Any, electrodes: int) -> _native.Protocol:
    """Pairs of a PyEITProtocol, one row a reading."""
    for name in ("ex_mat", "meas_mat"):
        if not hasattr(protocol, name):
            raise TypeError(f"argument 'protocol': it has no {name}; expected a PyEITProtocol of pyEIT 1.2")
    drives, senses = np.asarray(protocol.ex_mat), np.asarray(protocol.meas_mat)
    if drives.ndim != 2 or senses.ndim != 3 or len(senses) != len(drives) or drives.shape[1] != 2 or senses.shape[2] != 2:
        raise ValueError(
            f"argument 'protocol': ex_mat has shape {drives.shape} and meas_mat {senses.shape}; expected (drives, 2) and "
            "(drives, readings of a drive, 2)"
        )
    inject = np.repeat(drives, senses.shape[1], axis=0)
    return _native.Protocol.from_pairs(inject, senses.reshape(-1, 2), electrodes)


def _attribute(mesh: Any, name: str) -> NDArray[Any]:
    if not hasattr(mesh, name):
        raise TypeError(f"argument 'mesh': it has no {name}; expected a PyEITMesh of pyEIT 1.2")
    return np.asarray(getattr(mesh, name))


def _cut(mesh: Any) -> tuple[NDArray[np.float64], NDArray[np.int64], list[list[list[int]]], NDArray[np.int64]]:
    """Nodes, triangles, electrode edges, and the triangle of pyEIT of each triangle; those of pyEIT keep their places."""
    given, corners, places = (_attribute(mesh, name) for name in ("node", "element", "el_pos"))
    if given.ndim != 2 or given.shape[1] not in (2, 3) or given.dtype.kind not in "fiu":
        raise ValueError(f"argument 'mesh': node has shape {given.shape}; expected real positions of shape (nodes, 2) or (nodes, 3)")
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu" or not len(corners):
        raise ValueError(f"argument 'mesh': element has shape {corners.shape}; expected triangles, integers of shape (triangles, 3)")
    if corners.min() < 0 or corners.max() >= len(given):
        raise ValueError(f"argument 'mesh': element names node {corners.max()}; expected 0 to {len(given) - 1}")
    used, inverse = np.unique(corners, return_inverse=True)
    element = inverse.reshape(-1, 3).astype(np.int64)
    node = given[used, :2].astype(np.float64)
    if not np.abs(node).max() < 1e100:
        raise ValueError("argument 'mesh': node has a position that is not finite; expected positions in one unit of length")
    (p, q, r) = node[element].transpose(1, 0, 2)
    turned = (q - p)[:, 0] * (r - p)[:, 1] < (q - p)[:, 1] * (r - p)[:, 0]
    element[turned] = element[turned][:, ::-1]
    owner = _owners(places, used)
    # a side of one triangle only is an edge of the outline
    sides = element[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, counts = np.unique(sides.min(axis=1) * len(node) + sides.max(axis=1), return_index=True, return_counts=True)
    outline = first[counts == 1]
    added: list[NDArray[np.float64]] = []
    electrodes: list[list[list[int]]] = [[] for _ in owner]
    cuts: dict[int, dict[int, list[int]]] = {}
    at_electrode = np.isin(sides[outline], list(owner)).any(axis=1)
    for side in outline[at_electrode].tolist():
        start, end = sides[side].tolist()
        for here, there in ((start, end), (end, start)):
            if here in owner:
                new = len(node) + len(added)
                added.append((1.0 - _SHARE) * node[here] + _SHARE * node[there])
                electrodes[owner[here]].append([here, new])
                cuts.setdefault(side // 3, {}).setdefault(side % 3, []).append(new)
    for electrode, edges in enumerate(electrodes):
        if len(edges) != 2:
            raise ValueError(
                f"argument 'mesh': el_pos[{electrode}] is node {places.ravel()[electrode]}, which lies on {len(edges)} edges of the "
                "outline; expected a node of the outline, which has two"
            )
    parts, parents = [element], [np.arange(len(element))]
    for triangle, on_side in cuts.items():
        ring = [point for side in range(3) for point in (int(element[triangle, side]), *on_side.get(side, []))]
        middle = len(node) + len(added)
        added.append(node[element[triangle]].mean(axis=0))
        fan = np.array([[middle, point, following] for point, following in zip(ring, ring[1:] + ring[:1])])
        element[triangle] = fan[0]
        parts.append(fan[1:])
        parents.append(np.full(len(fan) - 1, triangle))
    return np.vstack([node, *added]), np.vstack(parts), electrodes, np.concatenate(parents)


def _owners(places: NDArray[Any], used: NDArray[np.int64]) -> dict[int, int]:
    """The electrode at each node."""
    if places.dtype.kind not in "iu" or places.size < 2:
        raise ValueError(f"argument 'mesh': el_pos is {places!r}; expected a node for each of two or more electrodes")
    owner: dict[int, int] = {}
    for electrode, place in enumerate(places.ravel().tolist()):
        at = int(np.searchsorted(used, place))
        if at == len(used) or used[at] != place:
            raise ValueError(f"argument 'mesh': el_pos[{electrode}] is {place}; expected a node of a triangle")
        if at in owner:
            raise ValueError(f"argument 'mesh': el_pos[{electrode}] and el_pos[{owner[at]}] are node {place}; expected one each")
        owner[at] = electrode
    return owner
