//! Bounded buffer of a stream's reader. If it is full, the oldest record is dropped and counted. No I/O.

use std::collections::VecDeque;
use std::sync::Arc;

use dbus::stream::set_gap;

/// Records waiting for one reader.
#[derive(Debug)]
pub(crate) struct Ring {
    waiting: VecDeque<Arc<[u8]>>,
    most: usize,
    dropped: u64,
}

impl Ring {
    /// Holds at most `most` records, at least one.
    pub(crate) fn new(most: usize) -> Self {
        Self {
            waiting: VecDeque::new(),
            most: most.max(1),
            dropped: 0,
        }
    }

    /// Adds an encoded record; drops the oldest if full.
    pub(crate) fn push(&mut self, record: Arc<[u8]>) {
        if self.waiting.len() == self.most {
            self.waiting.pop_front();
            self.dropped += 1;
        }
        self.waiting.push_back(record);
    }

    /// Removes and returns the oldest record, in which the number of records dropped before it is filled in.
    pub(crate) fn pop(&mut self) -> Option<Vec<u8>> {
        let mut record = self.waiting.pop_front()?.to_vec();
        set_gap(&mut record, std::mem::take(&mut self.dropped));
        Some(record)
    }
}

#[cfg(test)]
mod tests {
    use crate::recording::ring::*;
    use dbus::stream::{Body, Decoder, Record};

    fn record(sequence: u64) -> Arc<[u8]> {
        let record = Record {
            sequence,
            wall_ns: 0,
            gap: 0,
            simulated: false,
            body: Body::End {
                reason: String::new(),
            },
        };
        record.encode().into()
    }

    fn popped(ring: &mut Ring) -> Option<(u64, u64)> {
        let mut decoder = Decoder::new();
        decoder.push(&ring.pop()?);
        let record = decoder.next_record().unwrap().unwrap();
        Some((record.sequence, record.gap))
    }

    #[test]
    fn the_oldest_are_dropped_and_the_next_record_has_their_number() {
        let mut ring = Ring::new(3);
        for sequence in 1..=7 {
            ring.push(record(sequence));
        }
        assert_eq!(popped(&mut ring), Some((5, 4)));
        assert_eq!(popped(&mut ring), Some((6, 0)));
        ring.push(record(8));
        assert_eq!(popped(&mut ring), Some((7, 0)));
        assert_eq!(popped(&mut ring), Some((8, 0)));
        assert_eq!(popped(&mut ring), None);
    }
}
