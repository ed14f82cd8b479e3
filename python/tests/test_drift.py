"""Baselines that drift, and how far a map can be believed."""

import numpy as np
import pytest

from tactus_eit import Drift, Forward, Mesh, OneStep, Protocol, Shapes

NOISE = 2e-6


@pytest.fixture(scope="module")
def sheet():
    return Forward(Mesh.sheet(), Protocol.sheffield(26))


@pytest.fixture(scope="module")
def empty(sheet):
    return 1e-3 * sheet.solve(sheet.mesh.sigma0)


@pytest.fixture(scope="module")
def loaded(sheet):
    """A disc of 20 mm at (80, 135) mm."""
    pressed = np.hypot(*(sheet.mesh.centroids - [0.080, 0.135]).T) < 0.010
    return 1e-3 * sheet.solve(np.where(pressed, 0.5, 1.0) * sheet.mesh.sigma0)


def noisy(volts, seed):
    return volts + np.random.default_rng(seed).normal(0.0, NOISE, np.shape(volts))


def test_a_map_against_the_tracked_baseline_shows_the_load_only(sheet, empty, loaded):
    gains = 1.0 + 1e-3 * np.arange(1, 7)
    frames = noisy(gains[:, np.newaxis] * np.vstack([np.tile(empty, (5, 1)), loaded]), 1)
    followed = Drift(sheet).fit(noisy(empty, 2), noise=NOISE).follow(frames, 600.0 * np.arange(1, 7))
    assert [known["judgement"] for known in followed.known] == ["empty"] * 5 + ["loaded"]
    place = followed.known[-1]["place"]
    assert np.hypot(*(np.array(place["centre_mm"]) - [80.0, 135.0])) < 1.5
    model = OneStep(sheet).fit(noisy(empty, 2), noise=NOISE)
    tracked = model.predict(followed.frames, baselines=followed.baselines)
    untracked = model.predict(frames)
    # against the first baseline the map has the drift as well
    assert np.abs(tracked[4]).max() < 0.1 * np.abs(untracked[4]).max()
    found = sheet.mesh.centroids[sheet.mesh.region][tracked[5].argmin()]
    assert np.hypot(*(found - [0.080, 0.135])) < 0.008


def test_a_faulty_electrode_is_left_out(sheet, empty):
    uses = np.hstack([sheet.protocol.inject, sheet.protocol.measure])
    detached = np.where((uses == 7).any(axis=1), 1.3, 1.0) * empty
    drift = Drift(sheet).fit(noisy(empty, 2), noise=NOISE)
    followed = drift.follow(noisy([empty, detached, detached, detached], 3), [600.0, 1200.0, 1800.0, 2400.0])
    assert followed.known[-1]["masked"] == [8]
    np.testing.assert_array_equal(np.isnan(followed.frames[-1]), (uses == 7).any(axis=1))


def test_what_drift_needs_is_named(sheet, empty):
    with pytest.raises(ValueError, match="'noise'.*2e-6"):
        Drift(sheet).fit(empty)
    with pytest.raises(RuntimeError, match="call fit"):
        Drift(sheet).follow(empty, 1.0)
    with pytest.raises(TypeError, match="'forward'"):
        Drift(sheet.mesh)
    drift = Drift(sheet).fit(empty, noise=NOISE)
    with pytest.raises(ValueError, match=r"'times'.*\(1,\)"):
        drift.follow([empty, empty], 600.0)
    with pytest.raises(ValueError, match="'times'.*600 follows 600"):
        drift.follow([empty, empty], [600.0, 600.0])
    with pytest.raises(ValueError, match="'state'"):
        drift.restore("{}")
    other = Drift(Forward(Mesh.sheet(seeding=1), sheet.protocol)).fit(empty, noise=NOISE)
    with pytest.raises(ValueError, match="'state'"):
        other.restore(drift.state())
    with pytest.raises(ValueError, match="'baselines'.*2 rows.*1 frames"):
        OneStep(sheet).fit(empty).predict([empty], baselines=[empty, empty])
    with pytest.raises(ValueError, match="'noise'.*several frames"):
        Shapes(sheet).fit(empty)


def test_a_dead_electrode_makes_a_map_unreliable(sheet, empty, loaded):
    model = OneStep(sheet).fit(noisy(empty, 2), noise=NOISE)
    uses = np.hstack([sheet.protocol.inject, sheet.protocol.measure])
    dead = np.where((uses == 7).any(axis=1), 0.0, loaded)
    good, bad = model.judge(noisy([loaded, dead], 4))
    assert good.verdict == "sound" and good.reasons == ()
    assert bad.verdict == "unreliable"
    reason = bad.reasons[0]
    assert (reason.kind, reason.electrode) == ("dead_electrode", 7) and "electrode 8" in reason.text


def test_another_noise_than_the_stated_one_is_reported(sheet, empty, loaded):
    model = OneStep(sheet).fit(empty, noise=NOISE)
    frame = loaded + np.random.default_rng(5).normal(0.0, 10 * NOISE, loaded.shape)
    (quality,) = model.judge(frame)
    assert "noise" in [reason.kind for reason in quality.reasons]
