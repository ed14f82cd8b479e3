"""Results equal those of the Rust engine, bit for bit."""

import json

import numpy as np
import pytest
from conftest import PYTHON_FOLDER

import tactus_eit
from tactus_eit import Drift, Forward, Mesh, Network, OneStep, Protocol, Shapes, TotalVariation


def same_bits(left, right):
    assert left.dtype == right.dtype == np.float64
    np.testing.assert_array_equal(np.ascontiguousarray(left).view(np.int64), np.ascontiguousarray(right).view(np.int64))


@pytest.fixture(scope="module")
def case(expected):
    folder = expected.folder / "case"
    return Forward(Mesh.from_case(folder), Protocol.from_case(folder))


def test_case_folder_and_preset_are_the_same_mesh(case, mesh, protocol):
    assert case.mesh.hash == mesh.hash
    assert case.protocol == protocol
    same_bits(case.mesh.contact, mesh.contact)
    same_bits(case.mesh.sigma0, mesh.sigma0)


def test_forward_solution(case, expected):
    sigma = expected.array("sigma", -1)
    same_bits(case.solve(sigma), expected.array("readings", 208))
    same_bits(case.solve(np.vstack([sigma, sigma])), np.tile(expected.array("readings", 208), (2, 1)))


def test_jacobian_in_rows_of_readings(case, expected):
    sigma = expected.array("sigma", -1)
    same_bits(case.jacobian(sigma), expected.array("jacobian", 208, -1, order="F"))
    same_bits(case.jacobian(sigma, region=True, log=True), expected.array("relative", 208, -1, order="F"))


def test_transfer_impedance(case, expected):
    sigma = expected.array("sigma", -1)
    same_bits(case.transfer(sigma), expected.array("transfer", 16, 16))


@pytest.mark.parametrize(
    ("name", "noise", "sigma0", "make"),
    [
        ("one_step", None, None, lambda f: OneStep(f, missing="mask")),
        (
            "one_step_noise",
            3e-6,
            None,
            lambda f: OneStep(f, prior="gaussian", length=0.02, lam="noise", missing="mask"),
        ),
        (
            "one_step_fitted",
            None,
            "fitted",
            lambda f: OneStep(f, prior="laplace", lam="l-curve", losses_only=True, missing="mask"),
        ),
        ("one_step_figure", None, None, lambda f: OneStep(f, noise_figure=1.5, missing="mask")),
        ("tv", None, None, lambda f: TotalVariation(f, gap=1e-2, missing="mask")),
        ("shapes", None, None, lambda f: Shapes(f, missing="mask")),
    ],
)
def test_maps(case, expected, name, noise, sigma0, make):
    forward = case
    if sigma0 == "fitted":
        # a mesh from arrays states no conductance
        mesh = Mesh(case.mesh.nodes, case.mesh.triangles, case.mesh.electrodes)
        forward = Forward(mesh, case.protocol, case.contact)
    frames = expected.array("frames", 2, 208)
    frames[1, 5] = np.nan
    model = make(forward).fit(expected.array("baseline", 3, 208), noise=noise)
    maps = model.predict(frames)
    same_bits(maps, expected.array(name, 2, -1))
    assert model.masked_.tolist() == [0, 1]
    same_bits(model.predict(frames[0]), maps[0])
    same_bits(model.baseline_, expected.array("unloaded", 208))
    if noise is None:
        assert model.noise_ == expected.array("noise", 1)[0]


@pytest.fixture
def model_file():
    file = PYTHON_FOLDER.parent / "models" / "rbf-paper.safetensors"
    if not file.exists():
        pytest.skip("models/ of the project is not here")
    return file


@pytest.fixture(scope="module")
def sheet():
    return Forward(Mesh.sheet(), Protocol.sheffield(26))


def test_map_of_a_network(expected, sheet, model_file):
    baseline, frame = expected.array("network_readings", 2, 598)
    model = Network(sheet, model_file).fit(baseline)
    same_bits(model.predict(frame), expected.array("network", -1))
    assert model.method_ == "rbf paper"
    losses = Network(sheet, str(model_file), losses_only=True).fit(baseline).predict(frame)
    assert losses.max() <= 0.0 < model.predict(frame).max()


def test_a_network_of_another_sheet_is_refused(sheet, model_file, forward, baseline, tmp_path):
    with pytest.raises(ValueError, match="rbf-paper.*598 readings.*208"):
        Network(forward, model_file).fit(baseline)
    other = Forward(Mesh.sheet(seeding=1), Protocol.sheffield(26))
    with pytest.raises(ValueError, match="rbf-paper.*geometry"):
        Network(other, model_file).fit(1e-3 * other.solve(other.mesh.sigma0))
    with pytest.raises(FileNotFoundError, match="'path'.*nothing.safetensors"):
        Network(sheet, tmp_path / "nothing.safetensors").fit(1e-3 * sheet.solve(1e-3))
    (tmp_path / "torn.safetensors").write_bytes(model_file.read_bytes()[:1000])
    with pytest.raises(ValueError, match="torn.safetensors"):
        Network(sheet, tmp_path / "torn.safetensors").fit(1e-3 * sheet.solve(1e-3))


def test_tracked_baseline(case, expected):
    frames = np.vstack([expected.array("baseline", 3, 208)[2], expected.array("frames", 2, 208)[0]])
    drift = Drift(case).fit(expected.array("baseline", 3, 208))
    followed = drift.follow(frames, [600.0, 1200.0])
    same_bits(followed.baselines, expected.array("tracked", 2, 208))
    lines = (expected.folder / "tracked.jsonl").read_text().splitlines()
    assert followed.known == [json.loads(line) for line in lines]
    assert [known["judgement"] for known in followed.known] == ["empty", "loaded"]


def test_tracking_goes_on_from_its_state(case, expected):
    baseline = expected.array("baseline", 3, 208)
    frames = baseline * np.linspace(1.001, 1.003, 3)[:, np.newaxis]
    whole = Drift(case).fit(baseline)
    expect = whole.follow(frames, [600.0, 1200.0, 1800.0])
    first = Drift(case).fit(baseline)
    first.follow(frames[:2], [600.0, 1200.0])
    second = Drift(case).fit(baseline).restore(first.state())
    same_bits(second.follow(frames[2], 1800.0).baselines, expect.baselines[2:])
    assert second.state() == whole.state()


def test_a_mesh_from_arrays_is_the_same_mesh(case):
    mesh = case.mesh
    again = Mesh(mesh.nodes, mesh.triangles, mesh.electrodes, region=mesh.region)
    assert again.hash == mesh.hash
    assert again.contact is None and again.sigma0 is None


def test_results_do_not_share_memory_with_arguments(forward):
    sigma = np.full(len(forward.mesh.triangles), 1e-3)
    first = forward.solve(sigma)
    kept = first.copy()
    sigma[:] = 1.0
    forward.solve(sigma)
    same_bits(first, kept)


def test_threads_get_the_same_bits(forward):
    from concurrent.futures import ThreadPoolExecutor

    sigmas = [np.full(len(forward.mesh.triangles), 1e-3 * (1 + k)) for k in range(8)]
    alone = [forward.jacobian(sigma) for sigma in sigmas]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(forward.jacobian, sigmas)):
            same_bits(one, other)


def test_other_threads_run_during_a_solution():
    import threading
    import time

    forward = tactus_eit.Forward(Mesh.sheet(fineness=2.0), Protocol.sheffield(26))
    ticks = []
    done = threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    other = threading.Thread(target=tick)
    other.start()
    begin = time.monotonic()
    forward.jacobian(1e-3)
    end = time.monotonic()
    done.set()
    other.join()
    # with the lock held, the other thread would not tick in between
    within = [at for at in ticks if begin + 0.1 * (end - begin) < at < begin + 0.9 * (end - begin)]
    assert len(within) >= 3, (end - begin, len(within))
