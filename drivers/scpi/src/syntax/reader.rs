//! Reads one unit of a message from its bytes: header and arguments.

use crate::reading::{plain_number, split_block};
use crate::{Argument, Call, ParseError};

/// Longest keyword (IEEE 488.2 section 7.6.1.4.1).
const LONGEST_KEYWORD: usize = 12;

/// A position in a message.
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(crate) fn new(message: &'a [u8]) -> Self {
        Self { rest: message }
    }

    pub(crate) fn is_at_end(&self) -> bool {
        self.rest.is_empty()
    }

    /// Reads a unit up to its semicolon. `path` holds the parent nodes of the header before it.
    pub(crate) fn call(&mut self, path: &[String]) -> Result<Call, ParseError> {
        let from_root = self.skip_byte(b':');
        let common = self.skip_byte(b'*');
        let mut header = if from_root || common {
            Vec::new()
        } else {
            path.to_vec()
        };
        header.push(self.keyword()?);
        while !common && self.skip_byte(b':') {
            header.push(self.keyword()?);
        }
        let query = self.skip_byte(b'?');
        let arguments = match self.rest.first() {
            None | Some(b';') => Vec::new(),
            Some(b) if is_blank(*b) => self.arguments()?,
            Some(b) if is_separator(*b) => return Err(ParseError::InvalidSeparator),
            Some(_) => return Err(ParseError::InvalidCharacter),
        };
        Ok(Call {
            header,
            common,
            query,
            arguments,
        })
    }

    fn keyword(&mut self) -> Result<String, ParseError> {
        match self.rest.first() {
            Some(b) if b.is_ascii_alphabetic() => {}
            None | Some(b'*' | b'?' | b':' | b' ' | b';') => return Err(ParseError::Syntax),
            Some(_) => return Err(ParseError::InvalidCharacter),
        }
        let word = self.read_word();
        if word.len() > LONGEST_KEYWORD {
            return Err(ParseError::MnemonicTooLong);
        }
        Ok(word)
    }

    fn arguments(&mut self) -> Result<Vec<Argument>, ParseError> {
        let mut arguments = Vec::new();
        self.skip_blanks();
        if matches!(self.rest.first(), None | Some(b';')) {
            return Ok(arguments);
        }
        loop {
            self.skip_blanks();
            arguments.push(self.argument()?);
            self.skip_blanks();
            match self.rest.first() {
                None | Some(b';') => return Ok(arguments),
                Some(b',') => self.rest = &self.rest[1..],
                Some(_) => return Err(ParseError::InvalidSeparator),
            }
        }
    }

    fn argument(&mut self) -> Result<Argument, ParseError> {
        match self.rest.first() {
            None | Some(b',' | b';') => Err(ParseError::Syntax),
            Some(mark @ (b'"' | b'\'')) => self.text(*mark),
            Some(b'#') => self.hash(),
            Some(b'(') => self.expression(),
            Some(b) if b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.') => self.number(),
            Some(b) if b.is_ascii_alphabetic() => Ok(Argument::Word(self.read_word())),
            Some(_) => Err(ParseError::InvalidCharacter),
        }
    }

    fn number(&mut self) -> Result<Argument, ParseError> {
        let mantissa = |b: u8| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.');
        let mut length = count(self.rest, mantissa);
        if let Some(b'e' | b'E') = self.rest.get(length) {
            let after = &self.rest[length + 1..];
            let sign = usize::from(matches!(after.first(), Some(b'+' | b'-')));
            let digits = count(&after[sign..], |b| b.is_ascii_digit());
            if digits > 0 {
                length += 1 + sign + digits;
            }
        }
        let (text, rest) = self.rest.split_at(length);
        self.rest = rest;
        let value = std::str::from_utf8(text)
            .ok()
            .and_then(plain_number)
            .ok_or(ParseError::InvalidNumber)?;
        if value.is_infinite() {
            return Err(ParseError::ExponentTooLarge);
        }
        self.skip_blanks();
        let suffix = match self.rest.first() {
            Some(b) if b.is_ascii_alphabetic() => Some(self.read_word()),
            _ => None,
        };
        Ok(Argument::Number { value, suffix })
    }

    /// Reads an argument that starts with `#`: a definite block, or a number to base 16, 8 or 2.
    fn hash(&mut self) -> Result<Argument, ParseError> {
        let radix = match self.rest.get(1) {
            Some(b'h' | b'H') => 16,
            Some(b'q' | b'Q') => 8,
            Some(b'b' | b'B') => 2,
            Some(_) | None => {
                let (data, rest) = split_block(self.rest).ok_or(ParseError::InvalidBlock)?;
                self.rest = rest;
                return Ok(Argument::Block(data.to_vec()));
            }
        };
        self.rest = &self.rest[2..];
        let digits = self.read_word();
        // `from_str_radix` accepts a sign, which `read_word` never yields.
        let value = u64::from_str_radix(&digits, radix).map_err(|_| ParseError::InvalidNumber)?;
        Ok(Argument::Number {
            value: value as f64,
            suffix: None,
        })
    }

    fn text(&mut self, mark: u8) -> Result<Argument, ParseError> {
        let mut text = Vec::new();
        let mut at = 1;
        loop {
            match (self.rest.get(at), self.rest.get(at + 1)) {
                (None, _) => return Err(ParseError::InvalidString),
                (Some(&b), Some(&next)) if b == mark && next == mark => {
                    text.push(mark);
                    at += 2;
                }
                (Some(&b), _) if b == mark => break,
                (Some(&b), _) => {
                    text.push(b);
                    at += 1;
                }
            }
        }
        self.rest = &self.rest[at + 1..];
        let text = String::from_utf8(text).map_err(|_| ParseError::InvalidString)?;
        Ok(Argument::Text(text))
    }

    fn expression(&mut self) -> Result<Argument, ParseError> {
        let mut depth = 0usize;
        for (at, &b) in self.rest.iter().enumerate() {
            match b {
                b'(' => depth += 1,
                b')' => depth -= 1,
                b';' | b'"' | b'\'' | b'#' => return Err(ParseError::InvalidExpression),
                _ => {}
            }
            if depth == 0 {
                let (text, rest) = self.rest.split_at(at + 1);
                self.rest = rest;
                let text = String::from_utf8(text.to_vec());
                return text
                    .map(Argument::Expression)
                    .map_err(|_| ParseError::InvalidExpression);
            }
        }
        Err(ParseError::InvalidExpression)
    }

    /// Skips the rest of a rejected unit, up to the next semicolon outside a string.
    pub(crate) fn skip_unit(&mut self) {
        let mut quoted = None;
        let end = self.rest.iter().position(|&b| match quoted {
            Some(mark) => {
                if b == mark {
                    quoted = None;
                }
                false
            }
            None => {
                if matches!(b, b'"' | b'\'') {
                    quoted = Some(b);
                }
                b == b';'
            }
        });
        self.rest = &self.rest[end.unwrap_or(self.rest.len())..];
    }

    fn read_word(&mut self) -> String {
        let length = count(self.rest, |b| b.is_ascii_alphanumeric() || b == b'_');
        let (word, rest) = self.rest.split_at(length);
        self.rest = rest;
        word.iter().map(|&b| char::from(b)).collect()
    }

    pub(crate) fn skip_blanks(&mut self) {
        self.rest = &self.rest[count(self.rest, is_blank)..];
    }

    pub(crate) fn skip_byte(&mut self, byte: u8) -> bool {
        let eaten = self.rest.first() == Some(&byte);
        if eaten {
            self.rest = &self.rest[1..];
        }
        eaten
    }
}

fn count(bytes: &[u8], of: impl Fn(u8) -> bool) -> usize {
    bytes.iter().take_while(|&&b| of(b)).count()
}

/// White space of IEEE 488.2 section 7.4.1.2: the blank and all control characters except the line feed.
fn is_blank(byte: u8) -> bool {
    byte <= b' ' && byte != b'\n'
}

fn is_separator(byte: u8) -> bool {
    matches!(byte, b',' | b'"' | b'\'' | b'(' | b')' | b'#')
}
