//! The terminal's alternate screen: a picture that is redrawn, with two rows of text at the bottom.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::Write;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

use ratatui::crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use survey::printable_lines;

use crate::failure::Failure;
use crate::output::{complain, terminal_size, written};

/// Number of messages kept, to be printed after the screen is closed.
const KEPT: usize = 50;
/// Rows at the bottom: the last message, and the reason why there is no picture.
const BOTTOM: usize = 2;
const ENTER: &[u8] = b"\x1b[?1049h\x1b[?25l\x1b[2J";
const LEAVE: &[u8] = b"\x1b[?25h\x1b[?1049l";
/// Whether the alternate screen is shown.
static SHOWN: AtomicBool = AtomicBool::new(false);
/// Whether keys are read one by one and without echo.
static RAW: AtomicBool = AtomicBool::new(false);

/// The alternate screen. It is left when this is dropped, and before the message of a panic is printed.
pub(crate) struct Screen {
    messages: RefCell<VecDeque<String>>,
    waiting: RefCell<String>,
}

impl Screen {
    /// Shows the alternate screen and hides the cursor.
    ///
    /// # Errors
    /// [`Failure::Closed`] if the terminal is closed.
    pub(crate) fn enter() -> Result<Self, Failure> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let previous = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                leave();
                previous(panic);
            }));
        });
        SHOWN.store(true, Ordering::SeqCst);
        let screen = Self {
            messages: RefCell::default(),
            waiting: RefCell::default(),
        };
        write(ENTER)?;
        Ok(screen)
    }

    /// As [`Screen::enter`], and keys are read one by one and without echo.
    ///
    /// # Errors
    /// As [`Screen::enter`]; or the keys cannot be read.
    pub(crate) fn enter_raw() -> Result<Self, Failure> {
        let screen = Self::enter()?;
        enable_raw_mode()
            .map_err(|error| Failure::failed("the terminal's keys cannot be read", &error))?;
        RAW.store(true, Ordering::SeqCst);
        Ok(screen)
    }

    /// Columns of the screen, and rows above the two at the bottom.
    pub(crate) fn size(&self) -> (usize, usize) {
        let (columns, rows) = terminal_size().unwrap_or((80, 24));
        (columns, rows.saturating_sub(BOTTOM))
    }

    /// Draws text of this program, which may include escape sequences, from the first row.
    ///
    /// # Errors
    /// As [`Screen::enter`].
    pub(crate) fn draw(&self, text: &str) -> Result<(), Failure> {
        let mut bytes = b"\x1b[H".to_vec();
        for line in text.lines() {
            bytes.extend_from_slice(line.as_bytes());
            bytes.extend_from_slice(b"\x1b[K\r\n");
        }
        bytes.extend_from_slice(b"\x1b[J");
        write(&bytes)?;
        self.bottom()
    }

    /// Displays a message in the second-last row, and keeps it for [`Screen::close`].
    pub(crate) fn message(&self, text: &str) -> Result<(), Failure> {
        let mut messages = self.messages.borrow_mut();
        messages.truncate(KEPT - 1);
        messages.push_front(text.to_owned());
        drop(messages);
        self.bottom()
    }

    /// Displays in the last row why there is no picture; an empty text if there is one.
    pub(crate) fn waiting(&self, text: &str) -> Result<(), Failure> {
        if *self.waiting.borrow() == text {
            return Ok(());
        }
        text.clone_into(&mut self.waiting.borrow_mut());
        self.bottom()
    }

    fn bottom(&self) -> Result<(), Failure> {
        let (columns, above) = self.size();
        let messages = self.messages.borrow();
        let rows = [
            messages.front().cloned().unwrap_or_default(),
            self.waiting.borrow().clone(),
        ];
        let mut text = String::new();
        for (row, line) in rows.iter().enumerate() {
            let line: String = printable_lines(line).replace('\n', " ");
            let line: String = line.chars().take(columns).collect();
            text.push_str(&format!("\x1b[{};1H{line}\x1b[K", above + row + 1));
        }
        write(text.as_bytes())
    }

    /// Leaves the screen and prints the messages that were displayed on it.
    pub(crate) fn close(self) {
        leave();
        for message in self.messages.borrow().iter().rev() {
            complain(message);
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        leave();
    }
}

/// Returns to the normal screen if the alternate one is shown, and to line input with echo.
fn leave() {
    if RAW.swap(false, Ordering::SeqCst) {
        // an error means that the terminal is closed
        let _gone = disable_raw_mode();
    }
    if SHOWN.swap(false, Ordering::SeqCst) {
        // an error means that the terminal is closed
        let _gone = write(LEAVE);
    }
}

fn write(bytes: &[u8]) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    stdout
        .write_all(bytes)
        .and_then(|()| stdout.flush())
        .map_err(|error| written(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_leaves_the_alternate_screen() {
        let panicked = std::panic::catch_unwind(|| {
            let screen = Screen::enter().unwrap();
            assert!(SHOWN.load(Ordering::SeqCst));
            screen.message("lost").unwrap();
            panic!("of a test");
        });
        assert!(panicked.is_err());
        assert!(!SHOWN.load(Ordering::SeqCst));
    }
}
