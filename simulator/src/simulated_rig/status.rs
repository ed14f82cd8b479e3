//! The state of a served rig, for display.

use std::fmt;

use serde::{Deserialize, Serialize};

/// State of the rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The instruments' time, seconds.
    pub at_s: f64,
    /// Connected clients.
    pub clients: Vec<Client>,
    /// The current source.
    pub source: SourceStatus,
    /// The mainframe's relays that are actually closed.
    pub closed: Vec<u32>,
    /// Numbers of the electrodes on the board's poles: I+, I-, V+, V-.
    pub poles: [Option<usize>; 4],
    /// The last error that a message caused.
    pub last_error: Option<String>,
}

/// A connected client.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Client {
    /// Its instrument.
    pub instrument: String,
    /// Its address.
    pub address: String,
}

/// State of the source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceStatus {
    /// Whether the output is on.
    pub output: bool,
    /// The level it is set to, amperes.
    pub level_a: f64,
    /// The current that flows, amperes.
    pub flowing_a: f64,
    /// Full scale of the range, amperes.
    pub range_a: f64,
    /// Whether the voltage limit reduces the current.
    pub in_compliance: bool,
    /// Pulses sent on lines 1 to 6 of its trigger link.
    #[serde(default)]
    pub pulses: [u64; 6],
}

/// Maximum number of relays listed in a line.
const MOST_LISTED: usize = 12;

impl fmt::Display for Status {
    /// Four lines: clients, source, relays, last error; and a fifth once the source has sent pulses.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clients: Vec<String> = self
            .clients
            .iter()
            .map(|client| format!("{} from {}", client.instrument, client.address))
            .collect();
        writeln!(f, "clients  {}", or_none(&clients.join(", ")))?;
        let source = &self.source;
        let output = if source.output { "on" } else { "off" };
        write!(
            f,
            "6221     output {output}, {} set, {} flowing",
            amperes(source.level_a),
            amperes(source.flowing_a)
        )?;
        writeln!(
            f,
            "{}",
            if source.in_compliance {
                ", in compliance"
            } else {
                ""
            }
        )?;
        let lines = (1..).zip(source.pulses).filter(|(_, sent)| *sent > 0);
        let lines: Vec<String> = lines
            .map(|(line, sent)| format!("line {line}: {sent}"))
            .collect();
        if !lines.is_empty() {
            writeln!(f, "pulses   {}", lines.join(", "))?;
        }
        let named: Vec<String> = self
            .closed
            .iter()
            .take(MOST_LISTED)
            .map(u32::to_string)
            .collect();
        write!(f, "closed   {}", or_none(&named.join(", ")))?;
        if self.closed.len() > MOST_LISTED {
            write!(f, " and {} more", self.closed.len() - MOST_LISTED)?;
        }
        if self.poles.iter().any(Option::is_some) {
            let poles = ["I+", "I-", "V+", "V-"].iter().zip(self.poles);
            for (pole, electrode) in poles.filter_map(|(pole, on)| Some((pole, on?))) {
                write!(f, "; {pole} on {electrode}")?;
            }
        }
        writeln!(f)?;
        write!(
            f,
            "error    {}",
            survey::printable(self.last_error.as_deref().unwrap_or("none"))
        )
    }
}

/// Five digits with a prefix, as on the instrument's display.
fn amperes(value: f64) -> String {
    let prefixes = [(1e-3, "mA"), (1e-6, "uA"), (1e-9, "nA")];
    let fits = prefixes.iter().find(|(unit, _)| value.abs() >= *unit);
    let (unit, name) = match fits {
        _ if value == 0.0 => (1e-3, "mA"),
        Some(fits) => *fits,
        None => (1e-12, "pA"),
    };
    format!("{:.4} {name}", value / unit)
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

#[cfg(test)]
mod tests {
    use crate::simulated_rig::status::*;

    #[test]
    fn simulator_status_has_four_lines() {
        let status = Status {
            at_s: 1.0,
            clients: vec![Client {
                instrument: "34980a".to_owned(),
                address: "127.0.0.1:4711".to_owned(),
            }],
            source: SourceStatus {
                output: true,
                level_a: 1e-3,
                flowing_a: 0.0,
                range_a: 2e-3,
                in_compliance: true,
                pulses: [0; 6],
            },
            closed: (1001..1015).collect(),
            poles: [Some(3), None, None, None],
            last_error: None,
        };
        let mut reported = status.clone();
        reported.source.pulses[2] = 11;
        reported.source.flowing_a = -2.5e-6;
        let reported = reported.to_string();
        assert!(reported.contains("-2.5000 uA flowing"), "{reported}");
        assert_eq!(reported.lines().nth(2), Some("pulses   line 3: 11"));
        let text = status.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "clients  34980a from 127.0.0.1:4711");
        assert_eq!(
            lines[1],
            "6221     output on, 1.0000 mA set, 0.0000 mA flowing, in compliance"
        );
        assert!(
            lines[2].ends_with("1012 and 2 more; I+ on 3"),
            "{}",
            lines[2]
        );
        assert_eq!(lines[3], "error    none");
    }
}
