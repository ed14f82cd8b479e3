"""A stranger's client on tactus-sim: pyvisa-py over raw sockets. Arguments: host:port of the 6221, of the 34980A."""

import sys

import pyvisa


def open_socket(manager, address):
    host, port = address.rsplit(":", 1)
    return manager.open_resource(
        f"TCPIP0::{host}::{port}::SOCKET",
        read_termination="\n",
        write_termination="\n",
        timeout=20000,
    )


def main():
    manager = pyvisa.ResourceManager("@py")
    source = open_socket(manager, sys.argv[1])
    mainframe = open_socket(manager, sys.argv[2])

    identity = source.query("*IDN?")
    assert identity.split(",")[1] == "MODEL 6221", identity
    identity = mainframe.query("*IDN?")
    assert identity.split(",")[1] == "34980A", identity

    source.write("*RST;*CLS")
    source.write("SOUR:CURR:RANG 2e-3")
    source.write("SOUR:CURR:COMP 5")
    source.write("SOUR:CURR 1e-3")
    assert float(source.query("SOUR:CURR?")) == 1e-3
    source.write("OUTP ON")
    assert source.query("OUTP?") == "1"
    assert int(source.query("STAT:MEAS:COND?")) & 8, "an open source is in compliance"

    mainframe.write("*RST;*CLS")
    mainframe.write("CONF:VOLT:DC 1,(@1003)")
    mainframe.write("ROUT:CLOS (@1036)")
    assert mainframe.query("ROUT:CLOS? (@1036,1037)") == "1,0"
    assert not int(source.query("STAT:MEAS:COND?")) & 8, "a closed pair carries the current"

    # Ohm's law on the sheet: the reading is proportional to the current, and changes sign with it.
    readings = {}
    for current in (1e-3, 0.5e-3, -1e-3, 0.0):
        # Two connections know nothing of each other's order: the level is there once the source says so.
        assert int(source.query(f"SOUR:CURR {current!r};*OPC?")) == 1
        readings[current] = float(mainframe.query("READ?"))
    resistance = readings[1e-3] / 1e-3
    for current, volts in readings.items():
        assert abs(volts - resistance * current) <= 2e-8 * abs(readings[1e-3]), (current, volts)
    assert 1.0 < abs(resistance) < 1000.0, resistance

    source.write("SOUR:CLE")
    mainframe.write("ROUT:OPEN:ALL")
    for instrument in (source, mainframe):
        error = instrument.query("SYST:ERR?")
        assert int(error.split(",")[0]) == 0, error
    print(f"pair 3-4 over pair 1-2: {resistance:.6f} ohm, {len(readings)} currents")


if __name__ == "__main__":
    main()
