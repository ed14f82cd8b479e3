//! Methods of reconstruction in the daemon and offline: networks, and the tests of the paper.
//! Accuracy by itself is tested in `eit` and `lab`.

mod networks;
mod paper_over_scpi;
mod paper_test_one;
mod same_methods;
