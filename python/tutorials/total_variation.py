"""Maps with edges: total variation, losses only, and shapes."""

import time

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

protocol = tactus_eit.Protocol.sheffield(26)
fine, mesh = tactus_eit.Mesh.sheet(fineness=1.5, seeding=1), tactus_eit.Mesh.sheet()


def pressed(centroids):
    """A block of 60 mm x 30 mm, and a disc of 20 mm."""
    block = np.all(np.abs(centroids - [0.085, 0.150]) < [0.030, 0.015], axis=1)
    return block | (np.hypot(*(centroids - [0.140, 0.070]).T) < 0.010)


true = tactus_eit.Forward(fine, protocol)
volts = 1e-3 * true.solve([fine.sigma0, np.where(pressed(fine.centroids), 0.5, 1.0) * fine.sigma0])
baseline, frame = volts + np.random.default_rng(1).normal(0.0, 2e-6, volts.shape)
truth = np.where(pressed(mesh.centroids[mesh.region]), -0.5, 0.0)

forward = tactus_eit.Forward(mesh, protocol)
methods = {
    "one-step": tactus_eit.OneStep(forward),
    "one-step, losses only": tactus_eit.OneStep(forward, losses_only=True),
    "total variation": tactus_eit.TotalVariation(forward),
    "total variation, losses only": tactus_eit.TotalVariation(forward, losses_only=True),
    "shapes, losses only": tactus_eit.Shapes(forward, losses_only=True),
}
figure, axes = plt.subplots(1, 6, figsize=(14, 3), sharey=True)
maps = {"truth": truth}
for name, method in methods.items():
    method.fit(baseline, noise=2e-6)
    begin = time.perf_counter()
    maps[name] = method.predict(frame)
    took = time.perf_counter() - begin
    like = tactus_eit.likeness(maps[name], truth, mesh.areas[mesh.region])
    print(f"{name:29} correlation {like['correlation']:.2f}, dice {like['dice']:.2f}, largest loss {-100 * maps[name].min():.0f} %")
    print(f"time of {name}: {1e3 * took:.0f} ms")
for (name, change), axis in zip(maps.items(), axes):
    axis.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=change, cmap="RdBu_r", clim=(-0.6, 0.6))
    axis.set_title(name, fontsize=8)
    axis.set_aspect("equal")
figure.savefig("total-variation.png", dpi=90, bbox_inches="tight")
