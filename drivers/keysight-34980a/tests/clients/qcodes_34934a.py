"""QCoDeS drives the simulated mainframe: slot 1 a 34934A as 8x64, slot 2 a 34921A, slot 3 a 34934A without a terminal block."""

import sys
import warnings

from qcodes.instrument_drivers.Keysight import Keysight34980A

# The driver warns when the status byte tells of an error.
warnings.simplefilter("error")

unit = Keysight34980A("unit", f"TCPIP::127.0.0.1::{sys.argv[1]}::SOCKET", visalib="@py")
assert unit.get_idn()["model"] == "34980A", unit.get_idn()
assert {slot: info["model"] for slot, info in unit.system_slots_info.items()} == {
    1: "34934A-8x64",
    2: "34921A",
    3: "34934A-4x32",
}, unit.system_slots_info

matrix = unit.module[1]
assert (matrix.row, matrix.column) == (8, 64)
assert matrix.to_channel_list([(2, 3)]) == "(@1203)"
assert unit.module[3]._is_locked

assert matrix.is_open(2, 3) and not matrix.is_closed(2, 3)
matrix.connect(2, 3)
assert matrix.is_closed(2, 3)
matrix.connect_paths([(1, 1), (8, 64)])
assert matrix.are_closed([(1, 1), (8, 64), (2, 3), (4, 4)]) == [True, True, True, False]
matrix.disconnect(2, 3)
matrix.disconnect_paths([(1, 1)])
assert matrix.are_open([(1, 1), (2, 3), (8, 64)]) == [True, True, False]

assert matrix.protection_mode() == "AUTO100"
for mode in ["AUTO0", "FIX", "ISO"]:
    matrix.protection_mode(mode)
    assert matrix.protection_mode() == mode

unit.disconnect_all(1)
assert matrix.is_open(8, 64)
matrix.connect(1, 1)
unit.disconnect_all()
assert matrix.is_open(1, 1)

# Sixty-five one-wire relays are one too many.
try:
    matrix.connect_paths([(1, column) for column in range(1, 65)] + [(2, 1)])
    raise SystemExit("65 closures were taken")
except UserWarning:
    assert unit.get_error().startswith("+"), "no device error"
unit.reset()
assert unit.get_error() == '+0,"No error"'
unit.close()
