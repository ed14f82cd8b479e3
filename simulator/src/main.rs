//! `tactus-sim`: see the library.

fn main() -> std::process::ExitCode {
    simulator::run(std::env::args_os())
}
