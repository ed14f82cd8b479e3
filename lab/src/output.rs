//! Writes text to standard output. After a broken pipe (`| head`) commands continue without output, because their files
//! matter.

use std::fmt;
use std::io::{ErrorKind, Write};

/// Prints a line, like `println!`.
macro_rules! print_line {
    ($($text:tt)*) => { $crate::output::print(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints text, like `print!`.
macro_rules! print_text {
    ($($text:tt)*) => { $crate::output::print(format_args!($($text)*)) };
}

pub(crate) use {print_line, print_text};

/// Ends the program if the text cannot be written, for example to a full disk.
pub(crate) fn print(text: fmt::Arguments<'_>) {
    match std::io::stdout().lock().write_fmt(text) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            eprintln!("tactus-lab: standard output cannot be written: {error}");
            std::process::exit(1);
        }
        Ok(()) | Err(_) => {}
    }
}
