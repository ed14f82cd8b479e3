//! `tactus-archive`; the code is in the library.

fn main() -> std::process::ExitCode {
    archive::run(std::env::args_os())
}
