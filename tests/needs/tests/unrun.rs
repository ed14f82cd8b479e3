//! Lists the tests that did not run because the machine lacks something. Cargo runs this executable last: its package
//! is the last by name.

use std::process::ExitCode;

fn main() -> ExitCode {
    match needs::not_run() {
        Ok(tests) => {
            println!("\n{} tests did not run here", tests.len());
            for test in tests {
                println!("  {test}");
            }
            ExitCode::SUCCESS
        }
        Err(fault) => {
            eprintln!("the list of the tests that did not run: {fault}");
            ExitCode::FAILURE
        }
    }
}
