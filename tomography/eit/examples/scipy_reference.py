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

folder = Path(sys.argv[1])


def table(name):
    return np.loadtxt(folder / name, delimiter=",", skiprows=1)


nodes, elements = table("nodes.csv"), table("elems.csv").astype(int)
edges, electrodes = table("electrode_edges.csv").astype(int), table("electrodes.csv")
protocol, sigma = table("protocol.csv"), table("sigma_homog.csv")
n, count = len(nodes), len(electrodes)

p = nodes[elements]
d = p[:, [2, 0, 1]] - p[:, [1, 2, 0]]
area = 0.5 * (d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0])
local = np.einsum("tia,tja->tij", d, d) / (4 * area)[:, None, None]
gradients = np.stack([-d[:, :, 1], d[:, :, 0]], axis=2) / (2 * area)[:, None, None]
rows = np.repeat(elements, 3, axis=1).ravel()
columns = np.tile(elements, (1, 3)).ravel()

cr, cc, cv = [], [], []
for e, a, b in edges:
    h, z = np.hypot(*(nodes[a] - nodes[b])), electrodes[e, 1]
    cr += [a, b, a, b, a, b, n + e, n + e, n + e]
    cc += [a, b, b, a, n + e, n + e, a, b, n + e]
    cv += [h / (3 * z)] * 2 + [h / (6 * z)] * 2 + [-h / (2 * z)] * 4 + [h / z]
contact = sp.csc_matrix((cv, (cr, cc)), shape=(n + count, n + count))
drives = sorted({(int(s), int(t)) for s, t in protocol[:, 1:3]})
index = {drive: k for k, drive in enumerate(drives)}
right = np.zeros((n + count, len(drives)))
for k, (source, sink) in enumerate(drives):
    right[n + source, k], right[n + sink, k] = 1, -1
right[0] = 0
question = protocol[:, 1:5].astype(int)
drive = np.array([index[(s, t)] for s, t in question[:, :2]])


def fields(sigma):
    k = sp.csc_matrix(((sigma[:, None, None] * local).ravel(), (rows, columns)), shape=contact.shape) + contact
    keep = np.ones(n + count)
    keep[0] = 0
    k = sp.diags(keep) @ k @ sp.diags(keep) + sp.csc_matrix(([1.0], ([0], [0])), shape=k.shape)
    return splu(k.tocsc()).solve(right)


def readings(x):
    return x[n + question[:, 2], drive] - x[n + question[:, 3], drive]


def jacobian(x):
    sense = np.array([index[(s, t)] for s, t in question[:, 2:]])
    g = np.einsum("tka,tkd->tad", gradients, x[elements])
    return -area * np.einsum("tar,tar->tr", g[:, :, drive], g[:, :, sense]).T


def shortest(work, rounds):
    times = []
    for k in range(rounds):
        start = time.perf_counter()
        work(k)
        times.append(1e3 * (time.perf_counter() - start))
    return min(times)


changed = [sigma * (1 - 0.5 * ((np.arange(len(sigma)) * (k + 3) * 0.618) % 1)) for k in range(10)]
x = fields(sigma)
print(
    json.dumps(
        {
            "scipy": scipy.__version__,
            "forward_ms": shortest(lambda k: readings(fields(changed[k])), 10),
            "jacobian_ms": shortest(lambda k: jacobian(fields(changed[k])), 3),
            "largest_reading": float(np.abs(readings(x)).max()),
            "readings": readings(x).tolist(),
        }
    )
)
