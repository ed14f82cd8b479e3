//! Splits a byte stream into messages: handles partial, merged and oversized input.

use std::collections::VecDeque;

/// A message longer than the buffer: SCPI error -363. The bytes up to the next line feed are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a message of more than {most} bytes (-363, input buffer overrun); send shorter ones")]
pub struct Oversized {
    /// Longest message allowed, bytes without terminator.
    pub most: usize,
}

/// Lexical context of the next byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LexState {
    /// A block may start here: the start of the message, or after a blank, comma or semicolon.
    Gap,
    /// Inside a header or datum.
    Word,
    /// Inside a string; the byte is its closing quote.
    Quoted(u8),
    /// After a `#` at a position where a block may start.
    Hash,
    /// In the length of a block: digits left, length so far.
    Length(u8, usize),
    /// In a block: bytes left.
    Block(usize),
    /// Message longer than the buffer: bytes are dropped up to the next line feed.
    Overrun,
}

/// Cuts a stream of bytes into messages that end in LF or CR LF. Line feeds inside a definite block `#<n><length>...`
/// belong to the block. An empty line is an empty message.
///
/// Memory is bounded by the longest message plus what has not been taken yet.
///
/// ```
/// let mut framer = scpi::Framer::new(80);
/// framer.push(b"*IDN?\r\nOUTP");
/// assert_eq!(framer.next(), Some(Ok(b"*IDN?".to_vec())));
/// assert_eq!(framer.next(), None);
/// framer.push(b" 1\n");
/// assert_eq!(framer.next(), Some(Ok(b"OUTP 1".to_vec())));
/// ```
#[derive(Debug, Clone)]
pub struct Framer {
    most: usize,
    partial: Vec<u8>,
    state: LexState,
    ready: VecDeque<Result<Vec<u8>, Oversized>>,
}

impl Framer {
    /// A framer for messages of at most `max_line` bytes, terminator not counted.
    pub fn new(max_line: usize) -> Self {
        Self {
            most: max_line,
            partial: Vec::new(),
            state: LexState::Gap,
            ready: VecDeque::new(),
        }
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.take(byte);
        }
    }

    /// Whether bytes of an unfinished message are buffered (or dropped, after an overrun).
    pub fn is_partial(&self) -> bool {
        !self.partial.is_empty() || self.state == LexState::Overrun
    }

    /// Drops everything received: the partial message and the finished ones.
    pub fn clear(&mut self) {
        self.partial.clear();
        self.ready.clear();
        self.state = LexState::Gap;
    }

    fn take(&mut self, byte: u8) {
        if byte == b'\n' && !matches!(self.state, LexState::Block(_)) {
            return self.finish();
        }
        if self.state == LexState::Overrun {
            return;
        }
        self.partial.push(byte);
        self.state = self.next_state(byte);
        // One byte over the limit is kept, because it may be the CR of a CR LF.
        let held = self.partial.len() - usize::from(byte == b'\r');
        if held > self.most || self.state == LexState::Overrun {
            self.partial.clear();
            self.state = LexState::Overrun;
            self.ready.push_back(Err(Oversized { most: self.most }));
        }
    }

    fn next_state(&self, byte: u8) -> LexState {
        match (self.state, byte) {
            (LexState::Block(1), _) => LexState::Word,
            (LexState::Block(left), _) => LexState::Block(left - 1),
            (LexState::Quoted(end), _) if byte != end => LexState::Quoted(end),
            (LexState::Hash, b'1'..=b'9') => LexState::Length(byte - b'0', 0),
            (LexState::Length(left, so_far), b'0'..=b'9') => {
                // At most nine digits: fits even a 32-bit usize.
                let length = so_far * 10 + usize::from(byte - b'0');
                match (left, length) {
                    (1, 0) => LexState::Word,
                    // A block that cannot fit is rejected when its length is known, before its bytes arrive.
                    (1, length) if length > self.most => LexState::Overrun,
                    (1, length) => LexState::Block(length),
                    (left, so_far) => LexState::Length(left - 1, so_far),
                }
            }
            (LexState::Quoted(_), _) => LexState::Word,
            (_, b'"' | b'\'') => LexState::Quoted(byte),
            (LexState::Gap, b'#') => LexState::Hash,
            (_, b' ' | b'\t' | b',' | b';') => LexState::Gap,
            _ => LexState::Word,
        }
    }

    fn finish(&mut self) {
        if self.state != LexState::Overrun {
            if self.partial.last() == Some(&b'\r') {
                self.partial.pop();
            }
            self.ready.push_back(Ok(std::mem::take(&mut self.partial)));
        }
        self.state = LexState::Gap;
    }
}

/// The next complete message, or `None` until more bytes arrive. After a `None` the iterator may yield further
/// messages.
impl Iterator for Framer {
    type Item = Result<Vec<u8>, Oversized>;

    fn next(&mut self) -> Option<Self::Item> {
        self.ready.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn framed(most: usize, bytes: &[u8]) -> Vec<Result<Vec<u8>, Oversized>> {
        let mut framer = Framer::new(most);
        framer.push(bytes);
        framer.collect()
    }

    #[test]
    fn a_block_keeps_its_line_feeds() {
        assert_eq!(
            framed(80, b"DATA #15a\nb\nc;*OPC?\n"),
            [Ok(b"DATA #15a\nb\nc;*OPC?".to_vec())]
        );
        assert_eq!(
            framed(80, b"#213(@)\n456789012\n"),
            [Ok(b"#213(@)\n456789012".to_vec())]
        );
        assert_eq!(framed(80, b"#10\n"), [Ok(b"#10".to_vec())]);
    }

    #[test]
    fn a_hash_in_a_string_or_number_base_is_no_block() {
        assert_eq!(
            framed(80, b"X '#19\nY\n"),
            [Ok(b"X '#19".to_vec()), Ok(b"Y".to_vec())]
        );
        assert_eq!(
            framed(80, b"*ESE #HFF\nY\n"),
            [Ok(b"*ESE #HFF".to_vec()), Ok(b"Y".to_vec())]
        );
    }

    #[test]
    fn message_after_an_oversized_one_is_read() {
        let mut bytes = vec![b'A'; 1000];
        bytes.extend(b"\nB\n");
        assert_eq!(
            framed(10, &bytes),
            [Err(Oversized { most: 10 }), Ok(b"B".to_vec())]
        );
    }

    #[test]
    fn a_block_too_long_for_the_buffer_is_refused_at_once() {
        assert_eq!(framed(10, b"#9999999999"), [Err(Oversized { most: 10 })]);
    }

    #[test]
    fn a_message_may_fill_the_buffer_whatever_its_terminator() {
        assert_eq!(framed(3, b"ABC\nDEF\r\n").len(), 2);
        assert!(framed(3, b"ABC\nDEF\r\n").iter().all(Result::is_ok));
        assert!(framed(3, b"ABCD\n")[0].is_err());
    }
}
