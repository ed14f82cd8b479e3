//! `tactusd`.

fn main() -> std::process::ExitCode {
    daemon::run(std::env::args_os())
}
