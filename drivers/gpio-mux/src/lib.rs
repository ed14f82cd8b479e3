//! The GPIO multiplexer board: its line protocol, its driver, its simulator.
