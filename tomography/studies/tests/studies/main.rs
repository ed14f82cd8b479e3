//! Results of the studies: presses of the paper's Test #1, and the hard cases.

mod presses;
mod stability;
mod whole_sheet;
