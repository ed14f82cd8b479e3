"""A four-wire measurement through a 34934A: QCoDeS switches, the mainframe's voltmeter reads.

    tactus-sim serve --profile matrix-34934a --load "mesh 100" --port-6221 1394 --port-34980a 5025
    python qcodes_matrix.py TCPIP::127.0.0.1::1394::SOCKET TCPIP::127.0.0.1::5025::SOCKET
"""

import sys

if len(sys.argv) != 3:
    sys.exit(__doc__)

import pyvisa
from qcodes.instrument_drivers.Keysight import Keysight34980A

# Rows of the matrix: I+, I-, V+, V-; a column is an electrode.
I_PLUS, I_MINUS, V_PLUS, V_MINUS = 1, 2, 3, 4
AMPERE = 1e-3


def main():
    source = pyvisa.ResourceManager("@py").open_resource(
        sys.argv[1], read_termination="\n", write_termination="\n", timeout=20000
    )
    mainframe = Keysight34980A("mainframe", sys.argv[2], visalib="@py")
    matrix = mainframe.module[1]

    def resistance(plus, minus, high, low):
        """Volts between two electrodes per ampere through two others."""
        paths = [(I_PLUS, plus), (I_MINUS, minus), (V_PLUS, high), (V_MINUS, low)]
        matrix.connect_paths(paths)
        source.write("OUTP ON")
        assert source.query("STAT:MEAS:COND?") == "0", "nothing holds the current back"
        volts = float(mainframe.ask("READ?"))
        source.write("OUTP OFF")
        assert source.query("OUTP?") == "0"
        matrix.disconnect_paths(paths)
        return volts / AMPERE

    source.write(f"*RST;:SOUR:CURR:RANG 2e-3;COMP 5;:SOUR:CURR {AMPERE}")
    mainframe.write("CONF:VOLT:DC 1")
    there = resistance(1, 2, 8, 9)
    back = resistance(8, 9, 1, 2)
    print(f"1-2 to 8-9 {there:+.4f} ohm, 8-9 to 1-2 {back:+.4f} ohm")
    assert abs(there - back) < 1e-4, "a mesh of resistors is reciprocal"
    assert abs(there) > 1e-3
    assert mainframe.get_error() == '+0,"No error"'
    mainframe.close()


if __name__ == "__main__":
    main()
