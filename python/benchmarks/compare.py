"""Times of tactus_eit beside pyEIT on the same triangles, as a table in Markdown.

    python benchmarks/compare.py [--triangles 1000 10000] [--electrodes 16 26 32]

The mesh is a disc. pyEIT has an electrode at one node, tactus_eit the complete electrode model on some edges. Rows:

- forward: all readings of one conductance, assembly included
- Jacobian: derivatives of all readings, with the forward solution it needs
- set-up: everything from a mesh with readings of the empty tank to a method that makes maps; one-step, one strength for all frames
- frame: one map

A time is the smallest of several calls, for calls of more than five seconds of one. A case of 10,000 triangles takes pyEIT some
minutes and 4 GB.
"""

import argparse
import platform
import time
import warnings
from importlib.metadata import version

import numpy as np
import pyeit.eit.jac
import pyeit.eit.protocol
import pyeit.mesh
from pyeit.eit.fem import EITForward

import tactus_eit


def seconds(call):
    """The smallest time of a call, s: of at least three calls and half a second, or of one that takes five seconds."""
    times = []
    while not times or (len(times) < 3 or sum(times) < 0.5) and sum(times) < 5.0:
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return min(times)


def disc(electrodes, triangles):
    """The disc whose number of triangles is nearest."""
    sizes = np.geomspace(0.25, 4.0, 60)
    meshes = (tactus_eit.Mesh.disc(electrodes=electrodes, fineness=size) for size in sizes)
    return min(meshes, key=lambda mesh: abs(len(mesh.triangles) - triangles))


def times(electrodes, triangles):
    """A row for each kind of work: name, time of pyEIT, time of tactus_eit, s."""
    mesh = disc(electrodes, triangles)
    sigma = mesh.sigma0
    protocol = tactus_eit.Protocol.sheffield(electrodes)
    forward = tactus_eit.Forward(mesh, protocol)
    points = [int(edges[len(edges) // 2, 0]) for edges in mesh.electrodes]
    theirs = pyeit.mesh.PyEITMesh(node=mesh.nodes, element=mesh.triangles, perm=sigma, el_pos=np.array(points))
    pairs = pyeit.eit.protocol.create(electrodes)
    assert pairs.n_meas_tot == len(protocol)
    their_forward = EITForward(theirs, pairs)
    baseline = 1e-3 * forward.solve(sigma)
    frame = baseline * (1.0 + 1e-3 * np.sin(np.arange(len(baseline))))
    made = {}

    def their_setup():
        made["theirs"] = pyeit.eit.jac.JAC(theirs, pairs)
        made["theirs"].setup(p=0.5, lamb=0.01, method="kotre")

    def our_setup():
        model = tactus_eit.Forward(mesh, protocol)
        made["ours"] = tactus_eit.OneStep(model, lam="noise").fit(baseline, noise=2e-6)

    return len(mesh.triangles), [
        ("forward", seconds(lambda: their_forward.solve_eit(sigma)), seconds(lambda: forward.solve(sigma))),
        ("Jacobian", seconds(lambda: their_forward.compute_jac(sigma)), seconds(lambda: forward.jacobian(sigma))),
        ("set-up", seconds(their_setup), seconds(our_setup)),
        (
            "frame",
            seconds(lambda: made["theirs"].solve(frame, baseline)),
            seconds(lambda: made["ours"].predict(frame)),
        ),
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[1000, 10000])
    parser.add_argument("--electrodes", type=int, nargs="+", default=[16, 26, 32])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"pyEIT {version('pyeit')}, numpy {np.__version__}, Python {platform.python_version()}, {platform.machine()}", flush=True)
    print("\n| triangles | electrodes | work | pyEIT, ms | tactus_eit, ms | ratio |", flush=True)
    print("|---:|---:|---|---:|---:|---:|", flush=True)
    for triangles in options.triangles:
        for electrodes in options.electrodes:
            count, rows = times(electrodes, triangles)
            for work, theirs, ours in rows:
                print(
                    f"| {count:,} | {electrodes} | {work} | {1e3 * theirs:,.3g} | {1e3 * ours:,.3g} | {theirs / ours:,.3g} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
