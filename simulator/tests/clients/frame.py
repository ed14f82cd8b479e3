"""A stranger takes a 26 x 26 frame through both instruments, and judges it by physics. Arguments: resource names."""

import sys
import time

import pyvisa

ELECTRODES = 26
AMPERE = 1e-3


def opened(manager, name):
    if name.endswith("SOCKET"):
        return manager.open_resource(name, read_termination="\n", write_termination="\n", timeout=60000)
    return manager.open_resource(name, read_termination="\n", timeout=60000)


def main():
    manager = pyvisa.ResourceManager("@py")
    source = opened(manager, sys.argv[1])
    mainframe = opened(manager, sys.argv[2])
    least_s = float(sys.argv[3])

    source.write("*RST;*CLS")
    source.write("SOUR:CURR:RANG 2e-3")
    source.write("SOUR:CURR:COMP 10")
    mainframe.write("*RST;*CLS")
    mainframe.write("CONF:VOLT:DC 10,(@1001:1026)")
    mainframe.write("ROUT:CHAN:DEL 0,(@1001:1026)")

    # Nothing closed: no current, and the source says so.
    source.write(f"SOUR:CURR {AMPERE}")
    source.write("OUTP ON")
    assert int(source.query("STAT:MEAS:COND?")) & 8, "an open circuit is in compliance"

    def row(pair):
        readings = mainframe.query(f"ROUT:CLOS (@{1036 + pair});:READ?")
        mainframe.write(f"ROUT:OPEN (@{1036 + pair})")
        return [float(reading) for reading in readings.split(",")]

    def level(amperes):
        assert int(source.query(f"SOUR:CURR {amperes!r};*OPC?")) == 1

    begun = time.monotonic()
    frame = [row(pair) for pair in range(ELECTRODES)]
    took = time.monotonic() - begun
    assert took >= least_s, f"a frame in {took:.2f} s, faster than any instrument"
    largest = max(abs(volts) for volts in sum(frame, []))
    assert 0.01 < largest < 10, largest
    digit = 2e-7 * largest

    # Reciprocity: driving i and reading k is driving k and reading i.
    for i in range(ELECTRODES):
        for k in range(i):
            assert abs(frame[i][k] - frame[k][i]) < digit, (i, k, frame[i][k], frame[k][i])
    # Round the ring the voltages add up to nothing.
    for volts in frame:
        assert abs(sum(volts)) < ELECTRODES * digit, sum(volts)
    # The driven pair has the sign of the current, all others the opposite: current leaves through the sheet.
    for i, volts in enumerate(frame):
        assert volts[i] > 0 and all(volt < 0 for k, volt in enumerate(volts) if k != i), (i, volts)

    for share in (0.5, -1.0, 0.0):
        level(share * AMPERE)
        for pair in (0, 7, 25):
            for volts, whole in zip(row(pair), frame[pair]):
                assert abs(volts - share * whole) < digit, (share, pair, volts, whole)
    mainframe.write("ROUT:OPEN:ALL")
    source.write("SOUR:CLE")
    for instrument in (source, mainframe):
        error = instrument.query("SYST:ERR?")
        assert int(error.split(",")[0]) == 0, error
    print(f"{ELECTRODES} x {ELECTRODES} readings in {took:.2f} s, the largest {largest:.6f} V")


if __name__ == "__main__":
    main()
