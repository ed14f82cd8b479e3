//! Entries of the error queue: errors of the standard, and the instrument's own errors.

use scpi::ParseError;

/// An error to be added to the error queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct QueuedError {
    pub(super) code: i32,
    pub(super) text: &'static str,
}

/// The instrument's own error numbers, known from the similar 34970A (fact sheet section 7).
impl QueuedError {
    pub(super) const SLOT: Self = Self::new(111, "Channel list: slot number out of range");
    pub(super) const CHANNEL: Self = Self::new(112, "Channel list: channel number out of range");
    pub(super) const EMPTY: Self = Self::new(113, "Channel list: empty scan list");
    pub(super) const NOTHING_KEPT: Self = Self::new(291, "Not able to recall state: it is empty");
    pub(super) const COMMITTED: Self = Self::new(301, "Module currently committed to scan");
    pub(super) const UNABLE: Self = Self::new(305, "Not able to perform requested operation");
    pub(super) const PART_OF_PAIR: Self = Self::new(306, "Part of a 4-wire pair");
    pub(super) const CHANNEL_UNABLE: Self =
        Self::new(308, "Channel not able to perform requested operation");
    pub(super) const LOCKED: Self = Self::new(-203, "Command protected");
    pub(super) const DEADLOCK: Self = Self::new(-214, "Trigger deadlock");
    pub(super) const MEMORY: Self = Self::new(-225, "Out of memory");
    pub(super) const NO_SEQUENCE: Self = Self::new(-292, "Referenced name does not exist");
    pub(super) const NESTED_TOO_DEEP: Self = Self::new(-276, "Macro recursion error");

    const fn new(code: i32, text: &'static str) -> Self {
        Self { code, text }
    }
}

impl From<ParseError> for QueuedError {
    fn from(refusal: ParseError) -> Self {
        Self::new(refusal.code(), refusal.text())
    }
}
