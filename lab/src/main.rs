//! `tactus-lab`; the code is in the library.

fn main() -> std::process::ExitCode {
    lab::run(std::env::args_os())
}
