"""A current-voltage curve of one resistor: PyMeasure drives the source, plain VISA the mainframe.

    tactus-sim serve --load "resistor 1 2 470" --port-6221 1394 --port-34980a 5025
    python pymeasure_resistor.py TCPIP::127.0.0.1::1394::SOCKET TCPIP::127.0.0.1::5025::SOCKET
"""

import sys

if len(sys.argv) != 3:
    sys.exit(__doc__)

import pyvisa
from pymeasure.instruments.keithley import Keithley6221

LINES = {"read_termination": "\n", "write_termination": "\n"}


def main():
    source = Keithley6221(sys.argv[1], visa_library="@py", timeout=20000, **LINES)
    mainframe = pyvisa.ResourceManager("@py").open_resource(sys.argv[2], timeout=20000, **LINES)

    source.reset()
    source.source_range = 2e-3
    source.source_compliance = 5
    mainframe.write("*RST;*CLS")
    # Pair 1 is terminals 1 and 2: channel 1001 connects it to the voltmeter, channel 1036 to the source.
    mainframe.write("CONF:VOLT:DC 1,(@1001)")
    mainframe.write("ROUT:CLOS (@1036)")
    mainframe.query("*OPC?")

    source.enable_source()
    for milliampere in (-1.0, -0.5, 0.0, 0.5, 1.0):
        source.source_current = milliampere * 1e-3
        # Wait for the source's confirmation: the order of messages on two connections is undefined.
        assert float(source.ask("SOUR:CURR?")) == milliampere * 1e-3
        volts = float(mainframe.query("READ?"))
        print(f"{milliampere:+.1f} mA  {volts:+.6f} V")
        assert abs(volts - 470 * milliampere * 1e-3) < 1e-6
    source.shutdown()
    mainframe.write("ROUT:OPEN:ALL")
    assert mainframe.query("SYST:ERR?") == '+0,"No error"'


if __name__ == "__main__":
    main()
