//! Any of the five programs, selected by the first argument: started by the system tests.

use std::process::ExitCode;

fn main() -> ExitCode {
    tactus_tests::act_as(std::env::args_os()).unwrap_or_else(|| {
        eprintln!(
            "the first argument must be tactusd, tactus, tactus-sim, tactus-lab or tactus-archive"
        );
        ExitCode::from(2)
    })
}
