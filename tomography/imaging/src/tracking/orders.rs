//! Orders of users to the tracked baseline, stored as events of a session: recorded before they take effect, and
//! carried out by replay at the same frames.

use std::collections::VecDeque;
use std::fmt;
use std::path::Path;

use drift::TrackingOrder;
use logbook::{Event, LogbookError};

/// The kind of these events.
pub const ORDERED: &str = "tracking-ordered";

/// An order as stored in the text of its event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedOrder {
    /// The order.
    pub order: TrackingOrder,
    /// Number of the first frame to which it applies.
    pub from: u64,
    /// The user who gave it.
    pub by: String,
}

impl fmt::Display for RecordedOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { order, from, by } = self;
        write!(f, "{}, from frame {from} on, by {by}", order.name())
    }
}

impl RecordedOrder {
    /// Parses the text of an event; `None` if it is not an order.
    pub fn parse(text: &str) -> Option<Self> {
        let (name, rest) = text.split_once(", from frame ")?;
        let (from, by) = rest.split_once(" on, by ")?;
        Some(Self {
            order: TrackingOrder::named(name)?,
            from: from.parse().ok()?,
            by: by.to_owned(),
        })
    }
}

/// The orders of a session that were not carried out yet.
#[derive(Debug, Clone, Default)]
pub struct Orders(VecDeque<RecordedOrder>);

impl Orders {
    /// The orders among a session's events for frames after `after`.
    ///
    /// # Errors
    /// An event whose text is not an order, for example that of a newer version.
    pub fn recorded(events: &[Event], path: &Path, after: u64) -> Result<Self, LogbookError> {
        let of_kind = events.iter().filter(|event| event.kind == ORDERED);
        let orders = of_kind.map(|event| {
            RecordedOrder::parse(&event.text).ok_or_else(|| LogbookError::Damaged {
                path: path.to_owned(),
                place: format!("the event {ORDERED} of {}", event.at),
                why: format!(
                    "'{}' is not an order that this version knows: {}",
                    event.text,
                    TrackingOrder::ALL.map(TrackingOrder::name).join(", ")
                ),
            })
        });
        let orders: VecDeque<RecordedOrder> = orders.collect::<Result<_, _>>()?;
        let later = orders.into_iter().filter(|order| order.from > after);
        Ok(Self(later.collect()))
    }

    /// Removes and returns the orders for this frame and for earlier frames that were not tracked.
    pub fn due(&mut self, sequence: u64) -> Vec<TrackingOrder> {
        let due = self.0.iter().take_while(|order| order.from <= sequence);
        let count = due.count();
        self.0.drain(..count).map(|order| order.order).collect()
    }
}

#[cfg(test)]
mod tests {
    use chrono::DateTime;

    use super::*;

    fn event(kind: &str, text: &str) -> Event {
        Event {
            at: DateTime::UNIX_EPOCH,
            kind: kind.to_owned(),
            text: text.to_owned(),
        }
    }

    #[test]
    fn an_order_is_due_at_its_frame_and_only_once() {
        let orders = [
            (TrackingOrder::ForgetAnchor, 3),
            (TrackingOrder::EmptyNow, 7),
        ];
        let mut events: Vec<Event> = orders
            .map(|(order, from)| {
                let by = "user 1000, on, by hand".to_owned();
                let text = RecordedOrder { order, from, by }.to_string();
                let parsed = RecordedOrder::parse(&text).unwrap();
                assert_eq!((parsed.order, parsed.from), (order, from));
                event(ORDERED, &text)
            })
            .into();
        events.push(event("tracking", "no order"));
        let path = Path::new("m1");
        let mut all = Orders::recorded(&events, path, 0).unwrap();
        assert_eq!(all.due(2), []);
        assert_eq!(all.due(5), [TrackingOrder::ForgetAnchor]);
        assert_eq!(all.due(7), [TrackingOrder::EmptyNow]);
        assert_eq!(all.due(8), []);
        let mut rest = Orders::recorded(&events, path, 3).unwrap();
        assert_eq!(rest.due(100), [TrackingOrder::EmptyNow]);
        events.push(event(ORDERED, "explode, from frame 9 on, by user 0"));
        let refused = Orders::recorded(&events, path, 0).unwrap_err().to_string();
        assert!(refused.contains("explode") && refused.contains("empty-now"));
    }
}
