//! Tests of the studies: presses of the paper's Test #1, the hard cases, the quality check, maps over months, and
//! others.

mod honesty;
mod months;
mod presses;
mod rods;
mod stability;
mod whole_sheet;
