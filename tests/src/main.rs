//! Any of the four programs, named by the first argument: what the system tests start.

use std::process::ExitCode;

fn main() -> ExitCode {
    tactus_tests::act_as(std::env::args_os()).unwrap_or_else(|| {
        eprintln!("the first argument must be tactusd, tactus, tactus-sim or tactus-lab");
        ExitCode::from(2)
    })
}
