//! Results of the studies: presses of the paper's Test #1, the hard cases, and the check of maps.

mod honesty;
mod months;
mod presses;
mod rods;
mod stability;
mod whole_sheet;
