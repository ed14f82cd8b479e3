"""What a write and a query, and a frame of 26 x 26 readings, take with unmodified pyvisa.

    python pyvisa_speed.py TRIVIAL SOURCE MAINFRAME

each an address such as 127.0.0.1:40001, of servers that take no time; `speed` (this folder) starts them and runs this.
Prints writes with a query a second, and the least time of a frame in seconds.
"""

import sys

if len(sys.argv) != 4:
    sys.exit(__doc__)
import time

import pyvisa

LINES = {"read_termination": "\n", "write_termination": "\n", "timeout": 20000}
ASKED = 40
PAIRS = 26


def opened(address):
    host, port = address.split(":")
    return pyvisa.ResourceManager("@py").open_resource(f"TCPIP::{host}::{port}::SOCKET", **LINES)


def rate(trivial):
    begun = time.perf_counter()
    for _ in range(ASKED):
        trivial.write("SOUR:CURR 1e-3")
        trivial.query("SOUR:CURR?")
    return ASKED / (time.perf_counter() - begun)


def frame(source, mainframe):
    begun = time.perf_counter()
    for pair in range(1, PAIRS + 1):
        if pair > 1:
            mainframe.write(f"ROUT:OPEN (@{1034 + pair})")
        mainframe.write(f"ROUT:CLOS (@{1035 + pair})")
        readings = mainframe.query("READ?").split(",")
        assert len(readings) == PAIRS
        source.query("STAT:MEAS:COND?")
    return time.perf_counter() - begun


def main():
    trivial, source, mainframe = map(opened, sys.argv[1:4])
    print(max(rate(trivial) for _ in range(3)))
    print(min(frame(source, mainframe) for _ in range(3)))


if __name__ == "__main__":
    main()
