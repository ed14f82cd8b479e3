"""The forward model and the sensitivity of a case folder with scipy, timed: one line of JSON.

python scipy_reference.py CASE_FOLDER. The complete electrode model on linear triangles, the node-electrode system of
the fact sheet, SuperLU with the COLAMD order, one core; assembly vectorised, set-up not counted.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import scipy
import scipy.sparse as sp
from scipy.sparse.linalg import splu

class Sheet:
    """A mesh with electrodes and a protocol.

    nodes (nodes, 2), m; triangles (triangles, 3); edges (edges, 3): electrode and the two nodes of each edge that it covers; contact
    (electrodes,), ohm m; pairs (readings, 4): source, sink, plus, minus.
    """

    def __init__(self, nodes, triangles, edges, contact, pairs):
        count = len(nodes)
        p = nodes[triangles]
        d = p[:, [2, 0, 1]] - p[:, [1, 2, 0]]
        self.area = 0.5 * (d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0])
        self.local = np.einsum("tia,tja->tij", d, d) / (4 * self.area)[:, None, None]
        self.gradients = np.stack([-d[:, :, 1], d[:, :, 0]], axis=2) / (2 * self.area)[:, None, None]
        self.triangles, self.count = triangles, count
        self.rows, self.columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
        cr, cc, cv = [], [], []
        for e, a, b in edges:
            h, z = np.hypot(*(nodes[a] - nodes[b])), contact[e]
            cr += [a, b, a, b, a, b, count + e, count + e, count + e]
            cc += [a, b, b, a, count + e, count + e, a, b, count + e]
            cv += [h / (3 * z)] * 2 + [h / (6 * z)] * 2 + [-h / (2 * z)] * 4 + [h / z]
        size = count + len(contact)
        self.contact = sp.csc_matrix((cv, (cr, cc)), shape=(size, size))
        drives = sorted({(int(s), int(t)) for s, t in pairs[:, :2]})
        index = {drive: k for k, drive in enumerate(drives)}
        self.right = np.zeros((size, len(drives)))
        for k, (source, sink) in enumerate(drives):
            self.right[count + source, k], self.right[count + sink, k] = 1, -1
        self.right[0] = 0
        self.pairs = pairs
        self.drive = np.array([index[(s, t)] for s, t in pairs[:, :2]])
        self.sense = np.array([index[(s, t)] for s, t in pairs[:, 2:]])

    def fields(self, sigma):
        """Potentials of nodes and electrodes at 1 A: a column for each drive."""
        values = (sigma[:, None, None] * self.local).ravel()
        k = sp.csc_matrix((values, (self.rows, self.columns)), shape=self.contact.shape) + self.contact
        keep = np.ones(len(self.right))
        keep[0] = 0
        k = sp.diags(keep) @ k @ sp.diags(keep) + sp.csc_matrix(([1.0], ([0], [0])), shape=k.shape)
        return splu(k.tocsc()).solve(self.right)

    def readings(self, x):
        return x[self.count + self.pairs[:, 2], self.drive] - x[self.count + self.pairs[:, 3], self.drive]

    def jacobian(self, x):
        g = np.einsum("tka,tkd->tad", self.gradients, x[self.triangles])
        return -self.area * np.einsum("tar,tar->tr", g[:, :, self.drive], g[:, :, self.sense]).T


def shortest(work, rounds):
    times = []
    for k in range(rounds):
        start = time.perf_counter()
        work(k)
        times.append(1e3 * (time.perf_counter() - start))
    return min(times)


def main():
    folder = Path(sys.argv[1])

    def table(name):
        return np.loadtxt(folder / name, delimiter=",", skiprows=1)

    sigma = table("sigma_homog.csv")
    pairs = table("protocol.csv")[:, 1:5].astype(int)
    edges, contact = table("electrode_edges.csv").astype(int), table("electrodes.csv")[:, 1]
    sheet = Sheet(table("nodes.csv"), table("elems.csv").astype(int), edges, contact, pairs)
    changed = [sigma * (1 - 0.5 * ((np.arange(len(sigma)) * (k + 3) * 0.618) % 1)) for k in range(10)]
    readings = sheet.readings(sheet.fields(sigma))
    found = {
        "scipy": scipy.__version__,
        "forward_ms": shortest(lambda k: sheet.readings(sheet.fields(changed[k])), 10),
        "jacobian_ms": shortest(lambda k: sheet.jacobian(sheet.fields(changed[k])), 3),
        "largest_reading": float(np.abs(readings).max()),
        "readings": readings.tolist(),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
