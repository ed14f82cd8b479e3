//! What is said to a simulator, when, and what it answers.

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

    /// Lets the time be so many seconds after power on; the load is looked at.
    pub fn at(&mut self, seconds: f64) -> &mut Self {
        self.now = survey::duration(seconds);
        self.source.load_changed(self.now, &mut self.load);
        self
    }

    pub fn now(&self) -> Duration {
        self.now
    }

    /// The reply to one line; `-` is none.
    pub fn say(&mut self, line: &str) -> String {
        let reply = self.source.receive(line, self.now, &mut self.load).text;
        reply.unwrap_or_else(|| "-".to_owned())
    }

    /// Says lines and looks at each reply.
    pub fn hold(&mut self, lines: &[(&str, &str)]) -> &mut Self {
        for (said, expected) in lines {
            assert_eq!(
                self.say(said),
                *expected,
                "after '{said}' at {:?}",
                self.now
            );
        }
        self
    }

    /// The operation conditions.
    pub fn operation(&mut self) -> u16 {
        self.say("STAT:OPER:COND?").parse().unwrap()
    }
}
