//! `tactus top`: the running daemon on a full screen.
//!
//! [`web::follow`] reads the daemon, [`Dashboard`] holds the state of the screen, [`view::draw`] draws it. The last two
//! do not access a clock, the terminal or the bus.

mod dashboard;
mod history;
mod panels;
#[cfg(test)]
mod tests;
mod view;

use std::io::Write;
use std::time::Duration;

use chrono::Local;
use dbus::Address;
use ratatui::Terminal;
use ratatui::backend::{Backend, CrosstermBackend};
use ratatui::crossterm::event::{self, Event};
use ratatui::layout::Rect;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval};
use web::{Live, Snapshot};

use crate::args::{Global, Top};
use crate::connection;
use crate::control::top::dashboard::{Dashboard, Next};
use crate::control::watch::{end_signals, first_of};
use crate::failure::Failure;
use crate::output::screen::Screen;
use crate::output::{Printer, written};

/// Least time between two drawings of new data.
const DRAW_INTERVAL: Duration = Duration::from_millis(100);
/// Time after which the screen is drawn again without new data, because it shows ages.
const CLOCK_INTERVAL: Duration = Duration::from_secs(1);

/// Draws until a key or a signal ends it.
///
/// # Errors
/// Standard output is not a terminal; the terminal cannot be used.
pub(crate) fn run(
    global: &Global,
    requested: &Top,
    printer: &Printer<impl Write>,
) -> Result<(), Failure> {
    if !printer.is_terminal() {
        return Err(Failure::Usage(
            "`tactus top` needs a terminal, and the output is redirected; `tactus watch` prints a line for each \
             frame, with --json an object"
                .to_owned(),
        ));
    }
    let address = connection::wanted(global)?;
    crate::runtime::current_thread()?.block_on(async {
        let dashboard = Dashboard::new(printer.map_colour(), requested.scale);
        let live = Live::default();
        let changes = live.subscribe();
        // before entering the screen, so that a signal right after that leaves the screen too
        let mut signals = end_signals(true);
        let _screen = Screen::enter_raw()?;
        let backend = CrosstermBackend::new(std::io::stdout());
        let terminal = Terminal::new(backend).map_err(|error| written(&error))?;
        tokio::select! {
            ended = show(terminal, dashboard, changes, events(), address.clone()) => ended,
            () = web::follow(address.clone(), live) => Ok(()),
            number = first_of(&mut signals) => Err(Failure::Signal(number)),
        }
    })
}

/// Keys and changes of the terminal's size. The thread that reads them runs until the program ends.
fn events() -> mpsc::Receiver<std::io::Result<Event>> {
    let (send, receive) = mpsc::channel(16);
    std::thread::spawn(move || {
        loop {
            let event = event::read();
            let failed = event.is_err();
            if send.blocking_send(event).is_err() || failed {
                return;
            }
        }
    });
    receive
}

/// Draws changes and handles keys until one of them ends the program.
async fn show<B>(
    mut terminal: Terminal<B>,
    mut dashboard: Dashboard,
    mut changes: watch::Receiver<Snapshot>,
    mut events: mpsc::Receiver<std::io::Result<Event>>,
    address: Option<Address>,
) -> Result<(), Failure>
where
    B: Backend<Error = std::io::Error>,
{
    let mut ticks = interval(DRAW_INTERVAL);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut drawn_at: Option<Instant> = None;
    let mut orders: JoinSet<(String, Result<(), String>)> = JoinSet::new();
    loop {
        let due = drawn_at.is_none_or(|at| at.elapsed() >= CLOCK_INTERVAL);
        tokio::select! {
            _ = ticks.tick() => {
                let changed = changes.has_changed().unwrap_or(false);
                if changed {
                    dashboard.take(&changes.borrow_and_update());
                }
                if !(changed || due) {
                    continue;
                }
            }
            Some(done) = orders.join_next() => {
                if let Ok((name, done)) = done {
                    dashboard.acknowledged(&name, done);
                }
            }
            event = events.recv() => {
                let event = event.unwrap_or_else(|| Err(std::io::Error::other("the keyboard is no longer read")));
                let event = event.map_err(|error| Failure::failed("the terminal's keys cannot be read", &error))?;
                match dashboard.press(&event) {
                    Next::Stay => {}
                    Next::Leave => return Ok(()),
                    Next::Acknowledge(name) => {
                        let address = address.clone();
                        orders.spawn(async move {
                            let done = web::acknowledge(address.as_ref(), name.clone()).await;
                            (name, done)
                        });
                    }
                    // not `Terminal::clear`, which queries the terminal for the position of its cursor
                    Next::Redraw => {
                        let size = terminal.size().map_err(|error| written(&error))?;
                        terminal.resize(Rect::from(size)).map_err(|error| written(&error))?;
                    }
                }
            }
        }
        let now = Local::now().fixed_offset();
        terminal
            .draw(|frame| view::draw(frame, &dashboard, now))
            .map_err(|error| written(&error))?;
        drawn_at = Some(Instant::now());
    }
}
