"""The paper's Test #1: a disc of 10 mm at sixteen positions; the folder of the frames as the argument."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

if len(sys.argv) < 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
frames = np.loadtxt(folder / "frames.csv", delimiter=",", skiprows=1)
truth = np.loadtxt(folder / "truth.csv", delimiter=",")
mesh, protocol = tactus_eit.Mesh.from_case(folder), tactus_eit.Protocol.from_case(folder)
forward = tactus_eit.Forward(mesh, protocol)
areas, centroids = mesh.areas[mesh.region], mesh.centroids[mesh.region]


def middle(change):
    """The centre of the losses beyond half of the largest, m."""
    weights = areas * np.where(change < 0.5 * change.min(), -change, 0.0)
    return weights @ centroids / weights.sum()


places = np.array([middle(change) for change in truth])
figure, axes = plt.subplots(1, 3, figsize=(12, 4), sharey=True)
methods = {
    "one-step": tactus_eit.OneStep(forward),
    "total variation, losses only": tactus_eit.TotalVariation(forward, losses_only=True),
    "shapes, losses only": tactus_eit.Shapes(forward, losses_only=True),
}
for (name, method), axis in zip(methods.items(), axes):
    changes = method.fit(frames[0], noise=2e-6).predict(frames[1:])
    found = np.array([middle(change) for change in changes])
    errors = 1e3 * np.hypot(*(found - places).T)
    print(f"{name:28} location error: median {np.median(errors):.1f} mm, largest {errors.max():.1f} mm")
    deepest = (changes / -changes.min(axis=1)[:, np.newaxis]).min(axis=0)
    axis.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=deepest, cmap="inferno")
    axis.plot(*(1e3 * places.T), "wo", fillstyle="none", markersize=10)
    axis.plot(*(1e3 * found.T), "c+")
    axis.set_title(name)
    axis.set_aspect("equal")
figure.savefig("paper-test1.png", dpi=90, bbox_inches="tight")
