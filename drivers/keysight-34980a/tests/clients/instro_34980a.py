"""instro drives the simulated mainframe: slot 1 a 34922A on a steady voltage, slot 2 a 34931A.

Arguments: the port, and the voltage (1.25 V unless given)."""

import sys
import time

from instro.daq.drivers.keysight_34980a import Keysight34980A, parse_datastring
from instro.daq.types import AnalogVoltageChannel, Direction, HWTimingConfig, RelayChannel
from instro.lib.transports.visa import VisaConfig

VOLTS = float(sys.argv[2]) if len(sys.argv) > 2 else 1.25

unit = Keysight34980A(
    VisaConfig(f"TCPIP::127.0.0.1::{sys.argv[1]}::SOCKET", visa_backend="@py")
)
unit.open()


def channel(number):
    return AnalogVoltageChannel(
        physical_channel=number,
        alias=f"volts {number}",
        direction=Direction.INPUT,
        range_max=5.0,
        range_min=-5.0,
        scaler=None,
    )


# A list of its own with READ?, absolute time stamps near the host's.
unit.configure_ai_voltage_channel(channel("1001"))
unit.configure_ai_voltage_channel(channel("1002"))
readings, stamps = parse_datastring(unit.read_analog().data)
assert readings == [VOLTS, VOLTS], readings
assert stamps[0] < stamps[1]
assert all(abs(stamp - time.time_ns()) < 60e9 for stamp in stamps), stamps

# A scan paced by the timer, drained while it runs.
unit._ai_channels.clear()
unit.configure_ai_voltage_channel(channel("1003"))
period = 50_000_000
unit.configure_ai_hw_timing(HWTimingConfig(sample_rate=20.0, sample_period=period, samples_per_channel=4))
unit._ai_hw_timing_config = HWTimingConfig(sample_rate=20.0, sample_period=period, samples_per_channel=4)
unit.start()
stamps = []
for _ in range(3):
    readings, more = parse_datastring(unit.fetch_analog().data)
    assert len(readings) >= 4 and set(readings) == {VOLTS}, readings
    stamps += more
unit.stop()
steps = [second - first for first, second in zip(stamps, stamps[1:])]
# Stamps are written to the millisecond and cut to the microsecond by the client.
assert all(abs(step - period) < 2_000_000 for step in steps), steps

# Relays.
relay = RelayChannel(physical_channel="2101", alias="relay", direction=Direction.OUTPUT)
unit.close_relay(relay)
assert unit._visa.query("ROUT:CLOS? (@2101)").strip() == "1"
unit.open_relay(relay)
assert unit._visa.query("ROUT:CLOS? (@2101)").strip() == "0"
try:
    unit.close_relay(RelayChannel(physical_channel="2199", alias="none", direction=Direction.OUTPUT))
    raise SystemExit("a relay that is not there was closed")
except RuntimeError as refusal:
    assert "112" in str(refusal), refusal
unit.close()
