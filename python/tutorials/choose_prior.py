"""Prior and hyper-parameter of the one-step method, judged by maps whose truth is known."""

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

protocol = tactus_eit.Protocol.sheffield(26)
fine, mesh = tactus_eit.Mesh.sheet(fineness=1.5, seeding=1), tactus_eit.Mesh.sheet()
presses = [(0.080, 0.135, 0.010), (0.140, 0.080, 0.020)]


def pressed(centroids):
    return np.any([np.hypot(*(centroids - [x, y]).T) < radius for x, y, radius in presses], axis=0)


true = tactus_eit.Forward(fine, protocol)
volts = 1e-3 * true.solve([fine.sigma0, np.where(pressed(fine.centroids), 0.5, 1.0) * fine.sigma0])
baseline, frame = volts + np.random.default_rng(1).normal(0.0, 2e-6, volts.shape)
truth = np.where(pressed(mesh.centroids[mesh.region]), -0.5, 0.0)
areas = mesh.areas[mesh.region]
forward = tactus_eit.Forward(mesh, protocol)

choices = [
    ("noser, evidence", {}),
    ("noser, noise", {"lam": "noise"}),
    ("noser, L-curve", {"lam": "l-curve"}),
    ("tikhonov, evidence", {"prior": "tikhonov"}),
    ("laplace, evidence", {"prior": "laplace"}),
    ("gaussian 10 mm, evidence", {"prior": "gaussian", "length": 0.010}),
    ("noise figure 1", {"noise_figure": 1.0}),
    ("noise figure 0.2", {"noise_figure": 0.2}),
]
figure, axes = plt.subplots(2, 4, figsize=(11, 5.6), sharex=True, sharey=True)
for (name, settings), axis in zip(choices, axes.flat):
    change = tactus_eit.OneStep(forward, **settings).fit(baseline, noise=2e-6).predict(frame)
    like = tactus_eit.likeness(change, truth, areas)
    print(f"{name:26} correlation {like['correlation']:.2f}, largest loss {-100 * change.min():3.0f} %")
    limits = (change.min(), -change.min())
    axis.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=change, cmap="RdBu_r", clim=limits)
    for x, y, radius in presses:
        axis.add_patch(plt.Circle((1e3 * x, 1e3 * y), 1e3 * radius, fill=False))
    axis.set_title(f"{name}: {like['correlation']:.2f}", fontsize=9)
    axis.set_aspect("equal")
figure.savefig("choose-prior.png", dpi=90, bbox_inches="tight")
