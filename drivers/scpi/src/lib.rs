//! The grammar of SCPI, both directions, no I/O.
