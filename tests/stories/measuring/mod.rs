//! What a frame measures on a simulated sheet: baselines, presses, patterns, wirings, overloads.
//! How a frame travels over the wires is in `transport`.

mod baseline_and_press;
mod baseline_noise;
mod overload;
mod patterns;
mod wirings;
