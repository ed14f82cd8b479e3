//! A conversation with a simulator: messages, times, replies.

use std::time::Duration;

use keithley_6221::{Resistor, Settings6221, Simulator6221};
use survey::Ohms;

/// A fresh instrument with a resistor on its terminals.
pub struct Talk {
    pub source: Simulator6221,
    pub load: Resistor,
    now: Duration,
}

impl Talk {
    pub fn new(ohms: f64) -> Self {
        Self {
            source: Simulator6221::new(Settings6221::default()),
            load: Resistor::new(Ohms(ohms)),
            now: Duration::ZERO,
        }
    }

    /// Sets the time, s after power on; the load is evaluated.
    pub fn at(&mut self, seconds: f64) -> &mut Self {
        self.now = survey::duration(seconds);
        self.source.load_changed(self.now, &mut self.load);
        self
    }

    pub fn now(&self) -> Duration {
        self.now
    }

    /// The reply to one line; `-` means none.
    pub fn say(&mut self, line: &str) -> String {
        let reply = self.source.receive(line, self.now, &mut self.load).text;
        reply.unwrap_or_else(|| "-".to_owned())
    }

    /// Sends lines and checks each reply.
    pub fn hold(&mut self, lines: &[(&str, &str)]) -> &mut Self {
        for (line, expected) in lines {
            assert_eq!(
                self.say(line),
                *expected,
                "after '{line}' at {:?}",
                self.now
            );
        }
        self
    }

    /// The operation condition register.
    pub fn operation(&mut self) -> u16 {
        self.say("STAT:OPER:COND?").parse().unwrap()
    }
}
