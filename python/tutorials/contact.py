"""Contact of an electrode: how a changed one affects readings and map, and how it is detected."""

import matplotlib.pyplot as plt
import numpy as np
import tactus_eit

mesh, protocol = tactus_eit.Mesh.sheet(), tactus_eit.Protocol.sheffield(26)
forward = tactus_eit.Forward(mesh, protocol)
print(f"contact of the sheet: {forward.contact[0]:.3g} ohm m, {forward.contact[0] / mesh.electrode_lengths[0]:.3g} ohm an electrode")


def changed(factor):
    """The model with another contact at electrode 9."""
    return tactus_eit.Forward(mesh, protocol, np.where(np.arange(26) == 9, factor, 1.0) * forward.contact)


baseline = 1e-3 * forward.solve(mesh.sigma0)
noise = np.random.default_rng(1).normal(0.0, 2e-6, len(protocol))
uses = (np.hstack([protocol.inject, protocol.measure]) == 9).any(axis=1)
model = tactus_eit.OneStep(forward).fit(baseline, noise=2e-6)
factors, maps = (1.0, 1.5, 3.0, 10.0), []
for factor in factors:
    frame = 1e-3 * changed(factor).solve(mesh.sigma0) + noise
    relative = np.abs(frame / baseline - 1)
    (quality,) = model.judge(frame)
    maps.append(model.predict(frame))
    of_electrode, others = 100 * np.median(relative[uses]), 100 * np.median(relative[~uses])
    print(f"\ncontact times {factor:g}: readings of electrode 9 change by {of_electrode:.2f} %, others {others:.3f} %")
    print(f"largest change of the map of an empty sheet {100 * np.abs(maps[-1]).max():.1f} %; {quality.verdict}")
    for reason in quality.reasons:
        print(f"  {reason.kind}, electrode {reason.electrode}: {reason.text}")

figure, axes = plt.subplots(1, 4, figsize=(11, 3), sharey=True)
for axis, factor, change in zip(axes, factors, maps):
    shown = mesh.triangles[mesh.region]
    drawn = axis.tripcolor(*(1e3 * mesh.nodes.T), shown, facecolors=100 * change, cmap="RdBu_r", clim=(-20, 20))
    axis.plot(*(1e3 * mesh.electrode_centres[9]), "ks")
    axis.set_title(f"contact times {factor:g}")
    axis.set_aspect("equal")
figure.colorbar(drawn, ax=axes, label="change, %")
figure.savefig("contact.png", dpi=90, bbox_inches="tight")
