//! What is remembered: sessions, baselines, frames, events.
