//! Measurements on a simulated sheet: baselines, presses, patterns, wirings, overloads. `transport` tests the messages
//! of a frame.

mod baseline_and_press;
mod baseline_noise;
mod overload;
mod patterns;
mod wirings;
