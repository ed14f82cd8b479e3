"""Rotation, reflection and sign of an electrode order are found, and a baseline in a wrong order is refused."""

import numpy as np
import pytest

from tactus_eit import Forward, Mesh, OneStep, Protocol, check


@pytest.fixture(scope="module")
def sheet():
    return Forward(Mesh.sheet(fineness=0.25), Protocol.sheffield(26))


def recorded(forward, order):
    """A baseline, V at 1 mA, whose electrode e is electrode order[e] of the mesh; with 1 % of errors."""
    volts = 1e-3 * Forward(forward.mesh, forward.protocol.renumbered(order)).solve(1e-3)
    return volts * (1.0 + 0.01 * np.sin(np.arange(len(volts))))


@pytest.mark.parametrize("reflected", [False, True])
@pytest.mark.parametrize("rotation", [1, 3, 7, 12])
def test_every_order_is_found(sheet, rotation, reflected):
    steps = np.arange(26)
    order = (rotation - steps if reflected else rotation + steps) % 26
    found = check(recorded(sheet, order), sheet)
    # the sheet is symmetric in both axes: four orders look alike, and the order found is one of them
    assert found.equivalent == 4 and found.sign == 1 and not found.magnitudes
    alike = recorded(sheet, found.order)
    np.testing.assert_allclose(alike, recorded(sheet, order), rtol=0.03)
    assert found.residual < 0.01
    given = check(recorded(sheet, steps), sheet)
    assert found.ok == np.allclose(alike, recorded(sheet, steps), rtol=0.03)
    assert given.ok and given.rotation == 0 and not given.reflected


def test_a_rotated_order_is_refused_by_fit_and_mended(sheet):
    volts = recorded(sheet, (np.arange(26) + 3) % 26)
    with pytest.raises(ValueError, match=r"'baseline'.*rotated.*\(3 \+ e\).*renumbered") as raised:
        OneStep(sheet).fit(volts)
    assert "check_order=False" in str(raised.value)
    mended = Forward(sheet.mesh, sheet.protocol.renumbered(check(volts, sheet).order))
    assert OneStep(mended).fit(volts).order_.ok
    OneStep(sheet, check_order=False).fit(volts)


def test_readings_in_another_order_warn(sheet):
    volts = recorded(sheet, np.arange(26))
    with pytest.warns(UserWarning, match="'baseline'.*unexplained.*order of the readings"):
        OneStep(sheet).fit(np.roll(volts, 3))
    # four orders of the sheet look alike: nobody should have to ask for that
    assert any("symmetric" in note for note in OneStep(sheet).fit(volts).notes_)


def test_the_opposite_sign_is_refused(sheet):
    volts = recorded(sheet, np.arange(26))
    found = check(-volts, sheet)
    assert (found.ok, found.sign, found.rotation) == (False, -1, 0)
    with pytest.raises(ValueError, match="'baseline'.*opposite sign.*-baseline"):
        OneStep(sheet).fit(-volts)
    with pytest.raises(ValueError, match="'baseline'.*opposite sign.*-baseline"):
        OneStep(sheet, check_order=False).fit(-volts)


def test_magnitudes_of_readings_of_both_signs_are_refused(sheet):
    inject, measure = sheet.protocol.inject, sheet.protocol.measure.copy()
    measure[::2] = measure[::2, ::-1]
    forward = Forward(sheet.mesh, Protocol.from_pairs(inject, measure))
    volts = 1e-3 * forward.solve(1e-3)
    assert check(volts, forward).ok
    found = check(np.abs(volts), forward)
    assert found.magnitudes and not found.ok and found.rotation == 0
    with pytest.raises(ValueError, match="'baseline'.*magnitudes.*numpy.sign"):
        OneStep(forward).fit(np.abs(volts))


def test_a_round_tank_says_that_a_rotation_cannot_be_seen(forward, baseline):
    found = check(baseline, forward)
    assert found.ok and found.equivalent == 32
    assert "symmetric" in found.text
    turned = check(recorded(forward, (np.arange(16) + 5) % 16), forward)
    assert turned.ok and turned.rotation == 0


def test_noise_says_nothing_about_the_order(sheet):
    volts = np.random.default_rng(3).normal(0.0, 1e-3, 598)
    found = check(volts, sheet)
    assert found.rotation == 0 and not found.reflected and found.residual > 0.9
    assert "unexplained" in found.text


def test_missing_readings_are_left_out(sheet):
    volts = recorded(sheet, (np.arange(26) + 3) % 26)
    volts[:100] = np.nan
    assert check(volts, sheet).rotation == 3
    with pytest.raises(TypeError, match="'forward'"):
        check(volts, sheet.mesh)
