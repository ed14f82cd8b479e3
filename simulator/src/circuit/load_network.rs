//! The load on the terminals: the scene's sheet, or resistors instead of it.
//!
//! Terminal k is connected by the fixture like electrode k.

use std::fmt;
use std::str::FromStr;

use crate::circuit::{Point, Resistor};

/// The load on the terminals: the scene's sheet or a replacement.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum LoadNetwork {
    /// The scene's sheet.
    #[default]
    Sheet,
    /// No load: every terminal is open.
    Nothing,
    /// One resistor between two terminals, counted from 1.
    Resistor {
        /// One terminal.
        from: usize,
        /// The other terminal.
        to: usize,
        /// Its resistance, ohm.
        ohms: f64,
    },
    /// A square grid of equal resistors; the terminals are the nodes of its edge, counter-clockwise from the lower left
    /// corner. For 26 terminals it has 7 x 8 nodes.
    Mesh {
        /// Resistance of each, ohm.
        ohms: f64,
    },
}

/// Text that does not describe a load.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{words}' is not a load: {reason}")]
pub struct LoadNetworkError {
    /// The text.
    pub words: String,
    /// What is wrong, and what is allowed.
    pub reason: String,
}

impl LoadNetwork {
    /// The grammar of loads, for help texts.
    pub(crate) const GRAMMAR: &str = "\
sheet                   the scene's sheet
nothing                 every terminal is open
resistor FROM TO OHMS   one resistor between two terminals
mesh OHMS               a square grid of equal resistors, the terminals round its edge";

    /// The load as resistors between terminals; `None` for the sheet.
    pub(crate) fn resistors(&self, terminals: usize) -> Option<Vec<Resistor>> {
        match self {
            Self::Sheet => None,
            Self::Nothing => Some(Vec::new()),
            Self::Resistor { from, to, ohms } => Some(vec![Resistor {
                from: Point::Terminal(from - 1),
                to: Point::Terminal(to - 1),
                ohms: *ohms,
            }]),
            Self::Mesh { ohms } => Some(mesh(terminals, *ohms)),
        }
    }

    /// Number of the largest terminal used.
    pub(crate) fn terminals(&self) -> usize {
        match self {
            Self::Resistor { from, to, .. } => *from.max(to),
            Self::Sheet | Self::Nothing | Self::Mesh { .. } => 0,
        }
    }
}

/// A grid whose edge has at least this many nodes.
fn mesh(terminals: usize, ohms: f64) -> Vec<Resistor> {
    let half = terminals.div_ceil(2).max(2) + 2;
    let (columns, rows) = (half / 2, half - half / 2);
    let mut edge = Vec::new();
    edge.extend((0..columns).map(|x| (x, 0)));
    edge.extend((1..rows).map(|y| (columns - 1, y)));
    edge.extend((0..columns - 1).rev().map(|x| (x, rows - 1)));
    edge.extend((1..rows - 1).rev().map(|y| (0, y)));
    let point = |x: usize, y: usize| match edge.iter().position(|at| *at == (x, y)) {
        Some(index) => Point::Terminal(index),
        None => Point::Node(y * columns + x),
    };
    let mut resistors = Vec::new();
    for y in 0..rows {
        for x in 0..columns {
            let right = (x + 1 < columns).then(|| (x + 1, y));
            let above = (y + 1 < rows).then(|| (x, y + 1));
            for (x_to, y_to) in right.into_iter().chain(above) {
                resistors.push(Resistor {
                    from: point(x, y),
                    to: point(x_to, y_to),
                    ohms,
                });
            }
        }
    }
    resistors
}

impl fmt::Display for LoadNetwork {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sheet => f.write_str("sheet"),
            Self::Nothing => f.write_str("nothing"),
            Self::Resistor { from, to, ohms } => write!(f, "resistor {from} {to} {ohms}"),
            Self::Mesh { ohms } => write!(f, "mesh {ohms}"),
        }
    }
}

impl FromStr for LoadNetwork {
    type Err = LoadNetworkError;

    fn from_str(text: &str) -> Result<Self, LoadNetworkError> {
        let ohms = |word: &str| {
            let ohms = word.parse().ok();
            ohms.filter(|ohms| (1e-6..=1e15).contains(ohms))
                .ok_or_else(|| format!("a resistance is 1e-6 to 1e15 ohm, not '{word}'"))
        };
        let terminal = |word: &str| {
            let number = word.parse().ok();
            number
                .filter(|number| *number > 0)
                .ok_or_else(|| format!("terminals are counted from 1; '{word}' is not a terminal"))
        };
        let words: Vec<&str> = text.split_whitespace().collect();
        let load = match words.as_slice() {
            ["sheet"] => Ok(Self::Sheet),
            ["nothing"] => Ok(Self::Nothing),
            ["mesh", each] => ohms(each).map(|ohms| Self::Mesh { ohms }),
            ["resistor", from, to, each] => (|| {
                let (from, to) = (terminal(from)?, terminal(to)?);
                let ohms = ohms(each)?;
                match from == to {
                    true => Err(format!("both ends are terminal {from}; name two")),
                    false => Ok(Self::Resistor { from, to, ohms }),
                }
            })(),
            _ => {
                Err("it is written sheet, nothing, resistor FROM TO OHMS, or mesh OHMS".to_owned())
            }
        };
        load.map_err(|reason| LoadNetworkError {
            words: text.to_owned(),
            reason,
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::circuit::load_network::*;

    #[test]
    fn loads_read_as_they_are_written() {
        for words in ["sheet", "nothing", "resistor 1 3 470", "mesh 100"] {
            assert_eq!(words.parse::<LoadNetwork>().unwrap().to_string(), words);
        }
        for words in [
            "",
            "mesh",
            "mesh -1",
            "mesh inf",
            "resistor 1 1 5",
            "resistor 0 1 5",
        ] {
            assert!(words.parse::<LoadNetwork>().is_err(), "{words}");
        }
        for (words, reason) in [
            ("resistor 1 1 5", "both ends are terminal 1; name two"),
            (
                "resistor 1 2 -5",
                "a resistance is 1e-6 to 1e15 ohm, not '-5'",
            ),
            (
                "resistor 0 2 5",
                "terminals are counted from 1; '0' is not a terminal",
            ),
            ("mesh", "it is written sheet, nothing,"),
        ] {
            let refusal = words.parse::<LoadNetwork>().unwrap_err().to_string();
            let expected = format!("'{words}' is not a load: {reason}");
            assert!(refusal.starts_with(&expected), "{refusal}");
        }
    }

    #[test]
    fn a_mesh_of_26_terminals_is_7_by_8() {
        let resistors = mesh(26, 100.0);
        assert_eq!(resistors.len(), 6 * 8 + 7 * 7);
        let terminals: std::collections::BTreeSet<Point> = resistors
            .iter()
            .flat_map(|resistor| [resistor.from, resistor.to])
            .filter(|point| matches!(point, Point::Terminal(_)))
            .collect();
        assert_eq!(terminals.len(), 26);
        // Neighbours are connected by one resistor.
        let ring = (0..26).all(|k| {
            let pair = [Point::Terminal(k), Point::Terminal((k + 1) % 26)];
            resistors
                .iter()
                .any(|resistor| pair.contains(&resistor.from) && pair.contains(&resistor.to))
        });
        assert!(ring);
    }
}
