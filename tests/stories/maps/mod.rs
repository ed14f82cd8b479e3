//! Methods of reconstruction in the daemon and offline: networks, and the tests of the paper. `eit` and `lab` test the
//! accuracy of methods.

mod alarms;
mod injections;
mod networks;
mod paper_over_scpi;
mod paper_test_one;
mod quantities;
mod same_methods;
mod tracked;
