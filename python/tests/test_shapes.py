"""Shapes, units and attributes."""

import numpy as np
import pytest

import tactus_eit
from tactus_eit import Forward, Mesh, OneStep, Protocol, TotalVariation


def test_mesh_of_the_sheet():
    mesh = Mesh.sheet()
    assert mesh.nodes.shape == (5161, 2) and mesh.triangles.shape == (9612, 3)
    assert len(mesh.electrodes) == 26 and mesh.electrodes[0].shape[1] == 2
    assert mesh.region.shape == (3684,) and mesh.centroids.shape == (9612, 2) and mesh.areas.shape == (9612,)
    assert mesh.electrode_centres.shape == (26, 2) and mesh.electrode_lengths.shape == (26,)
    # 214 mm x 230 mm less 26 voids of 6 mm
    assert mesh.areas.sum() == pytest.approx(0.214 * 0.230 - 26 * 0.006**2, rel=1e-9)
    np.testing.assert_allclose(mesh.electrode_lengths, 0.024, rtol=1e-9)


def test_dimensions_of_the_sheet_in_metres():
    assert Mesh.sheet(width=0.214, height=0.23, electrode_size=0.006, inset=0.008).hash == Mesh.sheet().hash
    mesh = Mesh.sheet(width=0.107, height=0.115, electrode="edge", electrodes_per_width=4, electrodes_per_height=4)
    assert len(mesh.electrodes) == 16
    assert mesh.nodes.max(axis=0) == pytest.approx([0.107, 0.115])
    assert Mesh.sheet(fineness=0.5, seeding=1).hash != Mesh.sheet(fineness=0.5).hash


def test_disc_has_its_radius_and_electrodes_where_they_are_asked_for():
    mesh = Mesh.disc(radius=0.1, electrodes=8, arc_deg=10.0, first_deg=90.0, fineness=0.5)
    np.testing.assert_allclose(np.hypot(*mesh.nodes.T).max(), 0.1, rtol=1e-12)
    np.testing.assert_allclose(mesh.electrode_centres[0], [0.0, 0.1], atol=2e-4)


def test_protocols():
    protocol = Protocol.sheffield(16)
    assert len(protocol) == 208 and protocol.inject.shape == protocol.measure.shape == (208, 2)
    again = Protocol.from_pairs(protocol.inject, protocol.measure)
    assert again == protocol and hash(again) == hash(protocol) and again.hash == protocol.hash
    skipped = Protocol.sheffield(16, skip=2)
    assert skipped != protocol and skipped.inject[0].tolist() == [0, 3]
    assert Protocol.from_pairs([[0, 1]], [[2, 3]], electrodes=9).electrodes == 9
    order = np.roll(np.arange(16), 1)
    back = protocol.renumbered(order).renumbered(np.argsort(order))
    assert back == protocol


def test_forward_takes_numbers_rows_and_all_numeric_types(forward):
    triangles = len(forward.mesh.triangles)
    one = forward.solve(1e-3)
    assert one.shape == (208,)
    np.testing.assert_array_equal(forward.solve(np.full(triangles, 1e-3)), one)
    assert forward.solve(np.full((3, triangles), 1e-3)).shape == (3, 208)
    assert forward.solve(np.empty((0, triangles))).shape == (0, 208)
    assert forward.solve(np.ones(triangles, dtype=np.int16)).shape == (208,)
    np.testing.assert_array_equal(forward.solve(np.full(triangles, 0.5, dtype=np.float32)), forward.solve(0.5))
    # rows that are not contiguous, and the other byte order
    strided = np.full((2 * triangles,), 1e-3)[::2]
    np.testing.assert_array_equal(forward.solve(strided), one)
    np.testing.assert_array_equal(forward.solve(strided.astype(">f8")), one)
    assert forward.jacobian(1e-3).shape == (208, triangles)
    assert forward.transfer(1e-3).shape == (16, 16)


def test_the_jacobian_is_the_derivative_of_the_readings(forward):
    sigma = np.full(len(forward.mesh.triangles), 1e-3)
    direction = np.sin(np.arange(len(sigma)))
    step = 1e-8
    difference = (forward.solve(sigma + step * direction) - forward.solve(sigma - step * direction)) / (2.0 * step)
    product = forward.jacobian(sigma) @ direction
    assert np.abs(product - difference).max() < 1e-7 * np.abs(product).max()


def test_readings_are_differences_of_the_transfer_impedance(forward):
    transfer = forward.transfer(1e-3)
    inject, measure = forward.protocol.inject, forward.protocol.measure
    volts = transfer[:, inject[:, 0]] - transfer[:, inject[:, 1]]
    row = np.arange(len(inject))
    readings = volts[measure[:, 0], row] - volts[measure[:, 1], row]
    solved = forward.solve(1e-3)
    assert np.abs(readings - solved).max() < 1e-12 * np.abs(solved).max()


def test_contact_is_a_number_or_one_for_each_electrode(mesh, protocol):
    np.testing.assert_array_equal(Forward(mesh, protocol, 0.5).contact, np.full(16, 0.5))
    np.testing.assert_array_equal(Forward(mesh, protocol, np.arange(16)).contact, np.arange(16.0))


@pytest.mark.parametrize("method", [OneStep, TotalVariation])
def test_maps_show_the_load_where_it_is(forward, mesh, baseline, frame, method):
    model = method(forward).fit(baseline)
    maps = model.predict(np.vstack([frame, baseline[0]]))
    assert maps.shape == (2, len(mesh.region))
    weights = mesh.areas[mesh.region] * np.where(maps[0] < 0.5 * maps[0].min(), -maps[0], 0.0)
    found = weights @ mesh.centroids[mesh.region] / weights.sum()
    assert np.hypot(*(found - [0.05, 0.0])) < 0.01
    assert np.abs(maps[1]).max() < 0.1 * np.abs(maps[0]).max()
    assert model.method_ and model.notes_ and model.order_.ok
    assert model.sigma0_.shape == (len(mesh.triangles),)


def test_parameters_as_scikit_learn_wants_them(forward, baseline):
    model = OneStep(forward, prior="tikhonov", lam=0.5)
    params = model.get_params()
    assert params["forward"] is forward and params["prior"] == "tikhonov" and params["lam"] == 0.5
    again = OneStep(**params)
    assert all(again.get_params()[name] is value for name, value in params.items())
    assert model.set_params(lam=0.25) is model and model.lam == 0.25
    assert model.fit(baseline) is model
    assert "prior='tikhonov'" in repr(model)
    assert TotalVariation(forward).get_params()["gap"] == 1e-3


def test_noise_figure_that_was_asked_for(forward, baseline):
    model = OneStep(forward, noise_figure=2.0).fit(baseline)
    assert model.noise_figure_ == pytest.approx(2.0, rel=1e-3)
    assert OneStep(forward).fit(baseline).noise_figure_ is None


def test_noise_from_the_frames_of_the_baseline(forward, baseline):
    assert OneStep(forward).fit(baseline).noise_ == pytest.approx(1e-6, rel=0.2)
    assert OneStep(forward).fit(baseline[0]).noise_ is None
    assert OneStep(forward).fit(baseline, noise=3e-6).noise_ == 3e-6


def test_losses_only_maps_have_no_gain(forward, baseline, frame):
    maps = OneStep(forward, losses_only=True).fit(baseline).predict(frame)
    assert maps.max() <= 0.0 and maps.min() >= -1.0 and maps.min() < -0.1
    assert OneStep(forward).fit(baseline).predict(frame).max() > 0.0


def test_missing_readings_are_counted(forward, baseline, frame):
    model = OneStep(forward, missing="mask").fit(baseline)
    frames = np.vstack([frame, frame])
    frames[1, [3, 40]] = np.nan
    model.predict(frames)
    assert model.masked_.tolist() == [0, 2]


def test_merit_and_likeness():
    image = np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 1.0], [0.0, -1.0, 0.0]])
    merit = tactus_eit.merit(image, [0.0, 1.0])
    assert merit["amplitude"] == 4.0 and merit["centroid"] == (0.0, 0.5)
    like = tactus_eit.likeness([-0.5, 0.0, -0.5, 0.0], [-1.0, -1.0, 0.0, 0.0], [1.0, 1.0, 2.0, 2.0])
    assert like["dice"] == pytest.approx(0.4) and abs(like["correlation"]) < 1e-15


def test_likeness_without_a_load_is_not_known():
    like = tactus_eit.likeness([-0.5, 0.0], [0.0, 0.0], [1.0, 2.0])
    assert np.isnan([like["correlation"], like["relative_error"], like["dice"]]).all()
