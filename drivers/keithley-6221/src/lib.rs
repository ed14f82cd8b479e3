//! The Keithley 6221 current source: its commands, its driver, its simulator.
