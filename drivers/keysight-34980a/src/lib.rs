//! The Keysight 34980A switch and voltmeter: its commands, its modules, its driver, its simulator.
