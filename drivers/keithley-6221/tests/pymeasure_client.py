"""PyMeasure's Keithley6221, as it comes, against the simulator at host:port; 500 ohm are on its terminals."""

import sys
import time

from pymeasure.instruments.keithley import Keithley6221

HOST, PORT = sys.argv[1].rsplit(":", 1)
source = Keithley6221(
    f"TCPIP0::{HOST}::{PORT}::SOCKET",
    visa_library="@py",
    read_termination="\n",
    write_termination="\n",
    timeout=5000,
)


def check(what, found, expected):
    near = isinstance(expected, float) and abs(found - expected) <= 1e-6 * abs(expected)
    assert found == expected or near, f"{what}: {found!r} instead of {expected!r}"


def wait_until(what, reached):
    end = time.monotonic() + 120
    while not reached():
        assert time.monotonic() < end, f"{what}: not within 120 s"


def no_error():
    check("the error queue", list(source.check_errors()), [])


source.clear()
source.reset()
no_error()
assert "MODEL 6221" in source.id, source.id
check("options", source.options, "0")
check("complete", source.complete, "1")

# Every property reads back what was set.
SETTINGS = {
    "source_auto_range": [True, False],
    "source_range": [2e-9, 2e-6, 0.1],
    "source_current": [1e-3, -0.105, 0.0],
    "source_compliance": [0.1, 105.0, 10.0],
    "source_delay": [1e-3, 2.5],
    "source_enabled": [True, False],
    "shield_to_guard_enabled": [True, False],
    "output_low_grounded": [True, False],
    "delta_unit": ["Ohms", "W", "Siemens", "V"],
    "delta_high_source": [0.05, 1e-3],
    "delta_low_source": [-0.01, -1e-3],
    "delta_delay": [0.0, 9999.999],
    "delta_cycles": [1, 65536],
    "delta_measurement_sets": [1, 9999],
    "delta_compliance_abort_enabled": [True, False],
    "delta_cold_switch_enabled": [True, False],
    "delta_buffer_points": [1, 1000000],
    "buffer_points": [2, 1024],
    "waveform_function": ["ramp", "square", "arbitrary1", "arbitrary2", "arbitrary3", "arbitrary4", "sine"],
    "waveform_frequency": [1e-3, 1e5, 50.0],
    "waveform_amplitude": [2e-12, 0.105, 1e-3],
    "waveform_offset": [-0.105, 0.01, 0.0],
    "waveform_dutycycle": [0.0, 100.0, 50.0],
    "waveform_duration_time": [100e-9, 1000.0],
    "waveform_duration_cycles": [1e-3, 100.0],
    "waveform_ranging": ["fixed", "best"],
    "waveform_use_phasemarker": [True, False],
    "waveform_phasemarker_phase": [-180.0, 90.0, 180.0],
    "waveform_phasemarker_line": [1, 6],
    "display_enabled": [False, True],
    "measurement_event_enabled": [512, 0],
    "operation_event_enabled": [128, 0],
    "questionable_event_enabled": [16, 0],
    "srq_event_enabled": [128, 0],
}
for name, values in SETTINGS.items():
    for value in values:
        setattr(source, name, value)
        check(name, getattr(source, name), value)
no_error()
for endless in ["delta_delay", "delta_cycles", "delta_measurement_sets"]:
    setattr(source, endless, "INF")
    check(endless, getattr(source, endless), 9.9e37)
source.waveform_duration_set_infinity()
check("waveform_duration_time", source.waveform_duration_time, 9.9e37)
no_error()

# It really sends `ESE?`, which the instrument does not have: an error, and no reply.
source.write("ESE?")
check("an undefined query", source.next_error, [-113, '"Undefined header"'])

# No 2182A is connected.
check("delta_connected", source.delta_connected, False)
source.delta_arm()
check("delta mode", source.next_error[0], -241)
source.write("SENS:DATA?")
check("delta reading", source.next_error[0], -230)

# A current, held back by its limit.
source.reset()
source.source_range = 2e-3
source.source_current = 1e-3
source.enable_source()
check("source_enabled", source.source_enabled, True)
check("measurement_events", source.measurement_events, 0)
source.source_compliance = 0.4
check("measurement_events", source.measurement_events, 8)
source.disable_source()
check("source_enabled", source.source_enabled, False)

# A wave of 5 s that ends by itself, told by its service request bit.
source.clear()
source.waveform_function = "square"
source.waveform_amplitude = 1e-4
source.waveform_offset = 0
source.waveform_frequency = 100
source.waveform_ranging = "best"
source.waveform_duration_cycles = 500
source.operation_event_enabled = 128
source.srq_event_enabled = 128
source.waveform_arm()
source.waveform_start()
check("wave started", source.operation_events & 128, 0)
wait_until("end of the wave", lambda: int(source.ask("*STB?")) & 192 == 192)
check("wave stopped", source.operation_events & 128, 128)
source.waveform_abort()
source.define_arbitary_waveform([-1, 0, 0.5, 1], location=3)
check("waveform_function", source.waveform_function, "arbitrary3")
source.waveform_arm()
source.waveform_start()
source.waveform_abort()
no_error()

# A sweep of four points of a fifth of a second each.
source.clear()
source.source_delay = 0.2
source.write("SOUR:CURR:STAR 0;STOP 3e-4;STEP 1e-4;:SOUR:SWE:COUN 1;ARM")
started = time.monotonic()
source.delta_start()
check("complete", source.complete, "1")
took = time.monotonic() - started
assert 0.75 < took < 60, f"a sweep of 0.8 s took {took} s"
check("last point", source.source_current, 3e-4)
source.delta_abort()
no_error()

# Triggers.
source.set_timed_arm(0.5)
check("arm source", source.ask("ARM:SOUR?").strip(), "TIM")
source.trigger_immediately()
source.trigger_on_external(line=2)
source.output_trigger_on_external(line=3, after="DEL")
source.disable_output_trigger()
no_error()
source.trigger_on_bus()
check("a bus trigger in the trigger layer", source.next_error[0], -224)
source.trigger()
check("a trigger that nothing waits for", source.next_error[0], -211)

# The buffer, which stays empty.
source.config_buffer(points=64)
check("buffer_points", source.buffer_points, 64)
check("is_buffer_full", source.is_buffer_full(), False)
source.disable_buffer()
source.reset_buffer()
source.stop_buffer()
no_error()
source.beep(440, 0.1)
check("standard_events", source.standard_events & 4, 0)
check("questionable_events", source.questionable_events, 0)
no_error()
source.shutdown()
print("PyMeasure: all is as expected")
