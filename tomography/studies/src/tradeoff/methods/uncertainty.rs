//! Diagram 7: stated coverage against observed coverage.

use crate::tradeoff::panel::Panel;

pub(crate) fn panel() -> Panel {
    Panel {
        panel: "uncertainty".to_owned(),
        title: "Uncertainty: nominal against actual coverage".to_owned(),
        across: "nominal coverage".to_owned(),
        up: "share of truths inside".to_owned(),
        shows: "No method states an uncertainty with its map yet, so there is nothing to hold against the truth.".to_owned(),
        not_proved: "Bars elsewhere on this page are spreads over draws, not what a single map says of itself.".to_owned(),
        not_built: vec!["an uncertainty beside a map".to_owned()],
        costs: false,
        points: Vec::new(),
    }
}
