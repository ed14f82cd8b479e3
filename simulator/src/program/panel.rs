//! Status lines on a terminal that show a served rig, redrawn when it changes.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tracing_subscriber::fmt::MakeWriter;

use crate::SimulatedRig;

/// Minimum time between two redraws.
const PERIOD: Duration = Duration::from_millis(200);
/// Erases everything below the cursor, which is at the panel's first line.
const ERASE: &str = "\x1b[0J";

/// Lines at the end of standard error; messages are printed above them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Panel(Arc<Mutex<Drawn>>);

#[derive(Debug, Default)]
struct Drawn {
    text: String,
    /// Number of lines on the terminal.
    lines: usize,
}

impl Panel {
    fn drawn(&self) -> MutexGuard<'_, Drawn> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Draws the rig's state whenever it changes, as long as the future is polled.
    pub(crate) async fn keep_drawing(&self, rig: &SimulatedRig) {
        loop {
            let looked_at = rig.clone();
            // The state may need a solution of the sheet.
            let status = tokio::task::spawn_blocking(move || looked_at.status()).await;
            if let Ok(status) = status {
                self.draw(&status.to_string()).ok();
            }
            tokio::time::sleep(PERIOD).await;
        }
    }

    fn draw(&self, text: &str) -> io::Result<()> {
        let mut drawn = self.drawn();
        if drawn.text == text && drawn.lines > 0 {
            return Ok(());
        }
        let mut out = io::stderr().lock();
        erase(&mut drawn, &mut out)?;
        text.clone_into(&mut drawn.text);
        show(&mut drawn, &mut out)
    }
}

fn erase(drawn: &mut Drawn, out: &mut impl Write) -> io::Result<()> {
    if drawn.lines > 0 {
        write!(out, "\x1b[{}A\r{ERASE}", drawn.lines)?;
    }
    drawn.lines = 0;
    Ok(())
}

fn show(drawn: &mut Drawn, out: &mut impl Write) -> io::Result<()> {
    for line in drawn.text.lines() {
        // Escaped, because it quotes clients of the instruments. Without wrapping, so that each entry takes one line.
        let line = survey::printable(line);
        writeln!(out, "\x1b[?7l{line}\x1b[?7h")?;
    }
    drawn.lines = drawn.text.lines().count();
    out.flush()
}

impl Write for Panel {
    /// Prints above the panel.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut drawn = self.drawn();
        let mut out = io::stderr().lock();
        erase(&mut drawn, &mut out)?;
        out.write_all(bytes)?;
        show(&mut drawn, &mut out)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

impl<'a> MakeWriter<'a> for Panel {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

#[cfg(test)]
mod tests {
    use crate::program::panel::*;

    #[test]
    fn what_was_drawn_is_written_over() {
        let mut drawn = Drawn {
            text: "one\ntwo".to_owned(),
            lines: 0,
        };
        let mut out = Vec::new();
        erase(&mut drawn, &mut out).unwrap();
        assert!(out.is_empty());
        show(&mut drawn, &mut out).unwrap();
        assert_eq!(drawn.lines, 2);
        erase(&mut drawn, &mut out).unwrap();
        assert!(out.ends_with(b"\x1b[2A\r\x1b[0J"));
    }
}
