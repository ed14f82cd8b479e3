"""pyvisa-py over VXI-11. Argument: host:port of the core channel."""

import sys

import pyvisa


def main():
    host, port = sys.argv[1].rsplit(":", 1)
    manager = pyvisa.ResourceManager("@py")
    name = f"TCPIP::{host},{port}::inst0::INSTR"
    unit = manager.open_resource(name, read_termination="\n", timeout=20000)
    assert unit.query("*IDN?").split(",")[1] == "34980A"

    # Twenty thousand bytes are more than one write takes.
    unit.write(";".join(["*ESE 1"] * 3000) + ";*ESE 8")
    assert int(unit.query("*ESE?")) == 8

    # A reply read in pieces.
    unit.write("*IDN?")
    assert len(unit.read_bytes(10)) == 10
    assert b"34980A" in unit.read_raw()

    unit.write("*IDN?")
    while not unit.read_stb() & 16:
        pass
    assert "34980A" in unit.read()
    unit.write("*IDN?")
    unit.clear()
    assert int(unit.query("*ESE?")) == 8

    # Nobody asked: a timeout, and -420 in the queue.
    unit.timeout = 5000
    try:
        unit.read()
        raise SystemExit("a reply that nobody asked for")
    except pyvisa.errors.VisaIOError as error:
        assert error.error_code == pyvisa.constants.StatusCode.error_timeout, error
    unit.timeout = 20000
    assert unit.query("SYST:ERR?").startswith("-420")

    other = manager.open_resource(name, read_termination="\n", timeout=20000)
    other.lock_timeout = 200
    unit.lock_excl()
    try:
        other.write("*CLS")
        raise SystemExit("written past a lock")
    except pyvisa.errors.VisaIOError:
        pass
    unit.unlock()
    assert "34980A" in other.query("*IDN?")
    unit.write("TRIG:SOUR BUS;:CONF:VOLT:DC 1,(@1001);:TRIG:SOUR BUS;:INIT")
    unit.assert_trigger()
    assert len(unit.query("FETC?").split(",")) == 1
    assert unit.query("SYST:ERR?") == '+0,"No error"'
    unit.close()
    other.close()


if __name__ == "__main__":
    main()
