"""A network trained in PyTorch, exported as ONNX, and run by the engine."""

import matplotlib.pyplot as plt
import numpy as np
import onnx
import tactus_eit
import torch

# true voltages on a finer mesh than that of the maps
protocol = tactus_eit.Protocol.sheffield(16)
fine = tactus_eit.Mesh.disc(electrodes=16, fineness=1.0, seeding=1)
mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
true, forward = tactus_eit.Forward(fine, protocol), tactus_eit.Forward(mesh, protocol)
baseline = 1e-3 * true.solve(1e-3)


def presses(count, seed):
    """Frames (V) with 2 uV of noise, and true maps, of discs that lose a part of their conductance."""
    random = np.random.default_rng(seed)
    angle, loss = random.uniform(0, 2 * np.pi, count), random.uniform(0.2, 0.8, count)
    far, radius = 0.08 * np.sqrt(random.uniform(0, 1, count)), random.uniform(0.01, 0.025, count)
    centres = np.c_[far * np.cos(angle), far * np.sin(angle)]

    def changes(points):
        distance = np.linalg.norm(points[None] - centres[:, None], axis=2)
        return np.where(distance < radius[:, None], -loss[:, None], 0.0)

    volts = 1e-3 * true.solve(1e-3 * (1.0 + changes(fine.centroids)))
    return volts + random.normal(0.0, 2e-6, volts.shape), changes(mesh.centroids[mesh.region]), centres


# the input that the engine gives a network: one f32 a reading
frames, targets, _ = presses(4000, seed=1)
inputs = torch.tensor((frames - baseline) / np.abs(baseline).max(), dtype=torch.float32)
targets = torch.tensor(targets, dtype=torch.float32)

torch.manual_seed(1)
torch.set_num_threads(1)
scale = torch.nn.BatchNorm1d(len(protocol), affine=False)
network = torch.nn.Sequential(scale, torch.nn.Linear(len(protocol), 256), torch.nn.ELU(), torch.nn.Linear(256, targets.shape[1]))
optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
for epoch in range(40):
    for batch in torch.randperm(len(inputs)).split(128):
        optimiser.zero_grad()
        torch.nn.functional.mse_loss(network(inputs[batch]), targets[batch]).backward()
        optimiser.step()
network.eval()

# the file says for which protocol and mesh it was trained; others are then refused
torch.onnx.export(network, (inputs[:1],), "presses.onnx", external_data=False, verbose=False)
model = onnx.load("presses.onnx")
onnx.helper.set_model_props(model, {"tactus.survey": protocol.hash, "tactus.geometry": mesh.hash})
onnx.save(model, "presses.onnx")

tests, truth, places = presses(100, seed=2)
methods = {
    "network": tactus_eit.Network(forward, "presses.onnx", losses_only=True),
    "one-step": tactus_eit.OneStep(forward, losses_only=True),
}
maps = {name: method.fit(baseline, noise=2e-6).predict(tests) for name, method in methods.items()}
areas, points = mesh.areas[mesh.region], mesh.centroids[mesh.region]
for name, made in maps.items():
    like = np.mean([tactus_eit.likeness(one, real, areas)["correlation"] for one, real in zip(made, truth)])
    # the part that loses more than half of the largest loss
    found = np.array([np.average(points, axis=0, weights=areas * (one < 0.5 * one.min())) for one in made])
    print(f"{name}: correlation {like:.1f}, centre {1e3 * np.median(np.hypot(*(found - places).T)):.0f} mm off")

figure, axes = plt.subplots(1, 3, figsize=(10, 3), sharey=True)
for axis, (name, change) in zip(axes, {"true": truth[0], **{name: made[0] for name, made in maps.items()}}.items()):
    drawn = axis.tripcolor(*(1e3 * mesh.nodes.T), mesh.triangles[mesh.region], facecolors=100 * change, cmap="inferno")
    axis.set(title=name, xlabel="x, mm", aspect="equal")
    figure.colorbar(drawn, ax=axis)
figure.savefig("network-from-pytorch.png", dpi=100, bbox_inches="tight")
