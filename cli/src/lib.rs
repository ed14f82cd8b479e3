//! Who may interrupt: tactus.
