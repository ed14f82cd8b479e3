//! Parses a message into calls: units separated by semicolons, headers resolved by the path rule, arguments separated
//! by commas.

use std::fmt;

use crate::syntax::reader::Reader;
use crate::{Call, ParseError};

/// Parses one message (without its terminator) into its units. A unit with a syntax error yields that error at its
/// position; the units after it are still parsed. Empty units (a trailing `;`, an empty line) are skipped.
///
/// The path rule: a header without leading `:` continues at the parent node of the header before it; a leading `:`
/// starts at the root; common commands, with or without a `:` before them, do not change the path.
pub fn parse_message(message: impl AsRef<[u8]>) -> Vec<Result<Call, ParseError>> {
    let mut reader = Reader::new(message.as_ref());
    let mut path: Vec<String> = Vec::new();
    let mut calls = Vec::new();
    loop {
        reader.skip_blanks();
        if reader.is_at_end() {
            return calls;
        }
        if reader.skip_byte(b';') {
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

/// Joins commands, each written in short form from the root, to one message: `SOUR:CURR 1E-3;:SOUR:CURR?;*OPC?`.
pub fn join_units(commands: &[impl fmt::Display]) -> String {
    let mut message = String::new();
    for command in commands {
        let unit = command.to_string();
        if !message.is_empty() {
            message.push_str(if unit.starts_with('*') { ";" } else { ";:" });
        }
        message.push_str(&unit);
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Argument;

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
    fn units_after_a_refused_one_are_executed() {
        assert_eq!(
            headers("CURR 1 ';';COMP 2;FILT ';' x;*OPC?"),
            ["-103", "COMP", "-103", "*OPC"]
        );
    }
}
