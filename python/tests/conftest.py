"""A tank for all tests, and the results of the Rust engine that the package is compared with."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import tactus_eit

PYTHON_FOLDER = Path(__file__).parent.parent


class Expected:
    """What the Rust example wrote."""

    def __init__(self, folder):
        self.folder = folder

    def array(self, name, *shape, order="C"):
        return np.fromfile(self.folder / f"{name}.f64", dtype="<f8").reshape(shape, order=order)


@pytest.fixture(scope="session")
def expected(tmp_path_factory):
    """Runs the Rust example. Its bits depend on the processor, so that they cannot be a file of the repository."""
    folder = tmp_path_factory.mktemp("expected")
    built = os.environ.get("TACTUS_EIT_EXPECTED")
    if built is None and shutil.which("cargo") is None:
        pytest.skip("there is no cargo, which builds what the package is compared with")
    cargo = ["cargo", "run", "--quiet", "--release", "--features", "pyo3/extension-module", "--example", "expected", "--"]
    command = cargo if built is None else [built]
    done = subprocess.run([*command, str(folder)], cwd=PYTHON_FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return Expected(folder)


@pytest.fixture(scope="session")
def mesh():
    return tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)


@pytest.fixture(scope="session")
def protocol():
    return tactus_eit.Protocol.sheffield(16)


@pytest.fixture(scope="session")
def forward(mesh, protocol):
    return tactus_eit.Forward(mesh, protocol)


@pytest.fixture(scope="session")
def baseline(forward):
    """Three frames of 1 mA on 1 mS without a load, with errors of 1 uV."""
    errors = np.random.default_rng(1).normal(0.0, 1e-6, (3, 208))
    return 1e-3 * forward.solve(1e-3) + errors


@pytest.fixture(scope="session")
def frame(forward, mesh):
    """Half of the conductance lost within 30 mm of (50, 0) mm."""
    pressed = np.hypot(*(mesh.centroids - [0.05, 0.0]).T) < 0.03
    return 1e-3 * forward.solve(np.where(pressed, 0.5e-3, 1e-3))
