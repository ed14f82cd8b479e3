//! `tactus-bench`: see the library.

fn main() -> std::process::ExitCode {
    bench::run(std::env::args_os())
}
