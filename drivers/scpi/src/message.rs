//! A message to calls: units between semicolons, headers by the path rule, arguments between commas.

use crate::reading::{plain_number, split_block};
use crate::{Argument, ParseError, Pattern};

/// One unit of a message.
#[derive(Debug, Clone, PartialEq)]
pub struct Call {
    /// The keywords of the whole header from the root, as written; of a common command the one keyword without `*`.
    pub header: Vec<String>,
    /// Whether this is a common command (`*...`).
    pub common: bool,
    /// Whether the header ends with `?`.
    pub query: bool,
    /// The arguments in order.
    pub arguments: Vec<Argument>,
}

impl Call {
    /// Whether the header is this one, in the notation of [`Pattern`].
    ///
    /// # Panics
    /// When the notation is malformed.
    pub fn is(&self, notation: &str) -> bool {
        Pattern::new(notation).matches(self)
    }

    /// The arguments, when there are exactly `N`.
    ///
    /// # Errors
    /// -109 for fewer, -108 for more.
    pub fn exactly<const N: usize>(&self) -> Result<&[Argument; N], ParseError> {
        if self.arguments.len() > N {
            return Err(ParseError::ParameterNotAllowed);
        }
        self.arguments
            .as_slice()
            .try_into()
            .map_err(|_| ParseError::MissingParameter)
    }

    /// The only argument, or `None` when there is none.
    ///
    /// # Errors
    /// -108 for more than one.
    pub fn at_most_one(&self) -> Result<Option<&Argument>, ParseError> {
        match self.arguments.as_slice() {
            [] => Ok(None),
            [only] => Ok(Some(only)),
            _ => Err(ParseError::ParameterNotAllowed),
        }
    }
}

/// Reads one message (without its terminator) into its units. A unit that is not of the grammar is an error in its
/// place, and the units after it are still read. Empty units (a trailing `;`, an empty line) count for nothing.
///
/// The path rule: a header without leading `:` continues at the parent node of the header before it; a leading `:`
/// starts at the root; common commands, with or without a `:` before them, leave the path alone.
pub fn parse_message(message: impl AsRef<[u8]>) -> Vec<Result<Call, ParseError>> {
    let mut reader = Reader {
        rest: message.as_ref(),
    };
    let mut path: Vec<String> = Vec::new();
    let mut calls = Vec::new();
    loop {
        reader.skip_blanks();
        if reader.rest.is_empty() {
            return calls;
        }
        if reader.eat(b';') {
            continue;
        }
        let call = reader.call(&path);
        match &call {
            Ok(call) if !call.common => {
                path.clone_from(&call.header);
                path.pop();
            }
            Ok(_) => {}
            Err(_) => reader.skip_unit(),
        }
        calls.push(call);
    }
}

/// Longest keyword (IEEE 488.2 section 7.6.1.4.1).
const LONGEST_KEYWORD: usize = 12;

struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn call(&mut self, path: &[String]) -> Result<Call, ParseError> {
        let from_root = self.eat(b':');
        let common = self.eat(b'*');
        let mut header = if from_root || common {
            Vec::new()
        } else {
            path.to_vec()
        };
        header.push(self.keyword()?);
        while !common && self.eat(b':') {
            header.push(self.keyword()?);
        }
        let query = self.eat(b'?');
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
        let word = self.take_word();
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
            Some(b) if b.is_ascii_alphabetic() => Ok(Argument::Word(self.take_word())),
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
            Some(b) if b.is_ascii_alphabetic() => Some(self.take_word()),
            _ => None,
        };
        Ok(Argument::Number { value, suffix })
    }

    /// What starts with `#`: a definite block, or a number to base 16, 8 or 2.
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
        let digits = self.take_word();
        // `from_str_radix` would take a sign, which `take_word` never yields.
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

    /// Drops the rest of a unit that was refused, up to the next semicolon outside of a string.
    fn skip_unit(&mut self) {
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

    fn take_word(&mut self) -> String {
        let length = count(self.rest, |b| b.is_ascii_alphanumeric() || b == b'_');
        let (word, rest) = self.rest.split_at(length);
        self.rest = rest;
        word.iter().map(|&b| char::from(b)).collect()
    }

    fn skip_blanks(&mut self) {
        self.rest = &self.rest[count(self.rest, is_blank)..];
    }

    fn eat(&mut self, byte: u8) -> bool {
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

/// White space of IEEE 488.2 section 7.4.1.2: all control characters but the line feed, and the blank.
fn is_blank(byte: u8) -> bool {
    byte <= b' ' && byte != b'\n'
}

fn is_separator(byte: u8) -> bool {
    matches!(byte, b',' | b'"' | b'\'' | b'(' | b')' | b'#')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(message: &str) -> Vec<String> {
        parse_message(message)
            .into_iter()
            .map(|call| match call {
                Ok(call) if call.common => format!("*{}", call.header[0]),
                Ok(call) => call.header.join(":"),
                Err(refusal) => refusal.code().to_string(),
            })
            .collect()
    }

    #[test]
    fn the_path_carries_on_after_a_semicolon() {
        assert_eq!(
            headers("SOUR:CURR:RANG 1;COMP 2;:OUTP ON;STAT?"),
            ["SOUR:CURR:RANG", "SOUR:CURR:COMP", "OUTP", "STAT"]
        );
    }

    #[test]
    fn common_commands_do_not_move_the_path() {
        assert_eq!(
            headers("STAT:MEAS:ENAB 8;*CLS;EVEN?;:*OPC?;COND?"),
            [
                "STAT:MEAS:ENAB",
                "*CLS",
                "STAT:MEAS:EVEN",
                "*OPC",
                "STAT:MEAS:COND"
            ]
        );
    }

    #[test]
    fn what_clients_send_is_accepted() {
        assert_eq!(
            headers("status:queue:clear;*RST;:stat:pres;:*CLS;"),
            ["status:queue:clear", "*RST", "stat:pres", "*CLS"]
        );
        assert_eq!(headers(" ; ;*IDN? ; "), ["*IDN"]);
        assert!(headers("").is_empty());
    }

    #[test]
    fn arguments_keep_their_types() {
        let call = parse_message("DATA 1.5e-3 mA, ON ,'it''s; \"1\"',#13a;b,(@1, 2:3),#Q17")
            .remove(0)
            .unwrap();
        assert_eq!(
            call.arguments,
            [
                Argument::Number {
                    value: 1.5e-3,
                    suffix: Some("mA".to_owned())
                },
                Argument::Word("ON".to_owned()),
                Argument::Text("it's; \"1\"".to_owned()),
                Argument::Block(b"a;b".to_vec()),
                Argument::Expression("(@1, 2:3)".to_owned()),
                Argument::Number {
                    value: 15.0,
                    suffix: None
                },
            ]
        );
    }

    #[test]
    fn what_is_not_of_the_grammar_has_its_number() {
        for (message, code) in [
            ("CURR 1 2", "-103"),
            ("CURR,1", "-103"),
            ("CURR!", "-101"),
            ("\u{e9}", "-101"),
            ("CURR:", "-102"),
            ("CURR::RANG", "-102"),
            ("CURR 1,,2", "-102"),
            ("CURR 1,", "-102"),
            ("?", "-102"),
            ("**RST", "-102"),
            ("ABCDEFGHIJKLM", "-112"),
            ("CURR 1.2.3", "-121"),
            ("CURR --1", "-121"),
            ("CURR #H", "-121"),
            ("CURR 1e999", "-123"),
            ("DISP 'abc", "-151"),
            ("DATA #19abc", "-161"),
            ("DATA #", "-161"),
            ("ROUT:CLOS (@1001", "-171"),
        ] {
            assert_eq!(headers(message), [code], "{message}");
        }
    }

    #[test]
    fn units_after_a_refused_one_are_heard() {
        assert_eq!(
            headers("CURR 1 ';';COMP 2;FILT ';' x;*OPC?"),
            ["-103", "COMP", "-103", "*OPC"]
        );
    }
}
