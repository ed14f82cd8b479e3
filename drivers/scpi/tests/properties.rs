//! Properties that hold for any input: nothing panics, framing does not depend on how the bytes are divided, and
//! written values parse back to the same values.

use proptest::collection::vec;
use proptest::prelude::*;
use scpi::{
    Answer, Argument, ChannelEntry, ChannelList, Common, ErrorEntry, ErrorQueue, Framer, Numeric,
    Pattern, Unit, format_block, format_nr3, format_nr3_signed, parse_block, parse_message,
    parse_reading, parse_readings, quote, unquote,
};

/// Bytes that resemble SCPI often enough to reach most of the grammar.
fn scpi_like() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        "[A-Za-z]{1,5}".prop_map(String::into_bytes),
        "[:;?*,#(@) \"'\r\n.+-]".prop_map(String::into_bytes),
        "[0-9]{1,4}".prop_map(String::into_bytes),
        "[0-9.]{1,3}[eE][+-]?[0-9]{1,3}".prop_map(String::into_bytes),
        "#[0-9][0-9]{0,3}".prop_map(String::into_bytes),
        vec(any::<u8>(), 0..4),
    ];
    vec(piece, 0..24).prop_map(|pieces| pieces.concat())
}

fn argument() -> impl Strategy<Value = Argument> {
    let number = any::<f64>().prop_filter("SCPI has no way to write these", |v| v.is_finite());
    prop_oneof![
        (number, proptest::option::of("[A-DF-Z][A-Z]{0,3}"))
            .prop_map(|(value, suffix)| Argument::Number { value, suffix }),
        "[A-Za-z][A-Za-z0-9_]{0,11}".prop_map(Argument::Word),
        "[^\u{0}]{0,20}".prop_map(Argument::Text),
        "[ -~\n]{0,20}".prop_map(|text| Argument::Block(text.into_bytes())),
        channel_list().prop_map(|list| Argument::Expression(list.to_string())),
    ]
}

fn channel_list() -> impl Strategy<Value = ChannelList> {
    let entry = prop_oneof![
        (0u32..9999).prop_map(ChannelEntry::One),
        (0u32..9999, 0u32..9999).prop_map(|(first, last)| ChannelEntry::Range(first, last)),
    ];
    vec(entry, 0..8).prop_map(|entries| entries.into_iter().collect())
}

proptest! {
    #[test]
    fn no_input_can_panic(bytes in prop_oneof![scpi_like(), vec(any::<u8>(), 0..200)]) {
        let pattern = Pattern::new("[SOURce<n>]:CURRent[:LEVel<n>][:IMMediate]");
        for call in parse_message(&bytes).into_iter().flatten() {
            pattern.suffixes(&call);
            let _ = Common::of(&call);
            for argument in &call.arguments {
                let _ = argument.number(Unit::Ampere);
                let _ = argument.integer(i64::MIN, i64::MAX);
                let _ = argument.boolean();
                let _ = argument.channels();
                let _ = argument.choice(&[("OLOW", 1), ("GUARd", 2)]);
                let _ = argument.to_string();
            }
        }
        let text = String::from_utf8_lossy(&bytes);
        let _ = parse_readings(&text);
        let _ = parse_block(&bytes);
        let _ = text.parse::<ErrorEntry>();
        let _ = text.parse::<ChannelList>();
        let _ = unquote(&text);
    }

    #[test]
    fn framing_does_not_depend_on_how_bytes_arrive(
        bytes in scpi_like(),
        cuts in vec(1usize..7, 0..60),
        most in 1usize..40,
    ) {
        let mut whole = Framer::new(most);
        whole.push(&bytes);
        let expected: Vec<_> = whole.by_ref().collect();

        let mut pieces = Framer::new(most);
        let mut got = Vec::new();
        let mut rest = bytes.as_slice();
        for cut in cuts {
            let (piece, later) = rest.split_at(cut.min(rest.len()));
            pieces.push(piece);
            got.extend(pieces.by_ref());
            rest = later;
        }
        pieces.push(rest);
        got.extend(pieces.by_ref());

        prop_assert_eq!(&got, &expected);
        prop_assert_eq!(pieces.is_partial(), whole.is_partial());
        for message in got.into_iter().flatten() {
            prop_assert!(message.len() <= most);
        }
    }

    #[test]
    fn line_after_any_rubbish_is_read(rubbish in vec(any::<u8>(), 0..100)) {
        let mut framer = Framer::new(20);
        framer.push(&rubbish);
        // A block header in the random input may consume bytes up to the buffer's size; more line feeds than that end
        // the block.
        framer.push(&[b'\n'; 64]);
        framer.by_ref().for_each(drop);
        framer.push(b"*IDN?\r\n");
        prop_assert_eq!(framer.next(), Some(Ok(b"*IDN?".to_vec())));
    }

    #[test]
    fn arguments_read_back_as_written(arguments in vec(argument(), 1..5)) {
        let written: Vec<String> = arguments.iter().map(Argument::to_string).collect();
        let calls = parse_message(format!("DATA {};*OPC?", written.join(",")));
        prop_assert_eq!(calls.len(), 2);
        prop_assert_eq!(&calls[0].as_ref().unwrap().arguments, &arguments);
    }

    #[test]
    fn a_message_survives_framing(arguments in vec(argument(), 1..5)) {
        let written: Vec<String> = arguments.iter().map(Argument::to_string).collect();
        // A line-based connection cannot carry a string with a line feed, and a quote opens a string only where an
        // argument may start.
        prop_assume!(arguments.iter().all(|a| !matches!(a, Argument::Text(t) if t.contains('\n'))));
        let message = format!("DATA {}", written.join(","));
        let mut framer = Framer::new(10_000);
        framer.push(message.as_bytes());
        framer.push(b"\nX\n");
        prop_assert_eq!(framer.next(), Some(Ok(message.into_bytes())));
        prop_assert_eq!(framer.next(), Some(Ok(b"X".to_vec())));
    }

    #[test]
    fn channel_lists_read_back(list in channel_list()) {
        prop_assert_eq!(list.to_string().parse::<ChannelList>(), Ok(list));
    }

    #[test]
    fn numbers_read_back_to_their_digits(value in -1e30f64..1e30) {
        let relative = |text: &str| match parse_reading(text) {
            Ok(Answer::Value(read)) => (read - value).abs() / value.abs().max(f64::MIN_POSITIVE),
            other => panic!("{text}: {other:?}"),
        };
        prop_assert!(relative(&format_nr3(value, 6)) < 6e-7);
        prop_assert!(relative(&format_nr3_signed(value, 8)) < 6e-9);
    }

    #[test]
    fn formatted_numbers_keep_their_bits(value in any::<f64>().prop_filter("finite", |v| v.abs() < 9.9e37)) {
        let call = parse_message(format!("X {}", Numeric::Value(value))).remove(0).unwrap();
        match call.arguments[0].number(Unit::None) {
            Ok(Numeric::Value(read)) => prop_assert_eq!(read.to_bits(), value.to_bits()),
            // Values near the reserved 9.91E37 are also read as not-a-number.
            other => prop_assert!(value.abs() > 9.8e37, "{value}: {other:?}"),
        }
    }

    #[test]
    fn a_reading_is_never_a_huge_or_missing_value(text in "[+-]?([0-9.eE+-]{1,12}|INF|NAN|NaN|inf)") {
        if let Ok(Answer::Value(value)) = parse_reading(&text) {
            prop_assert!(value.abs() < 9.9e37);
        }
    }

    #[test]
    fn strings_and_blocks_read_back(text in ".{0,40}", data in vec(any::<u8>(), 0..40)) {
        prop_assert_eq!(unquote(&quote(&text)), Some(text));
        let block = format_block(&data);
        prop_assert_eq!(parse_block(&block), Ok(data.as_slice()));
    }

    #[test]
    fn an_error_queue_keeps_its_depth_and_its_oldest(codes in vec(-500i32..1000, 0..40), depth in 1usize..12) {
        let mut queue = ErrorQueue::new(depth);
        for code in &codes {
            queue.push(*code, "x");
            prop_assert!(queue.len() <= depth);
        }
        for (k, code) in codes.iter().enumerate().take(depth) {
            let expected = if k + 1 == depth && codes.len() > depth { -350 } else { *code };
            prop_assert_eq!(queue.pop().code, expected);
        }
        prop_assert_eq!(queue.pop(), ErrorEntry::none());
    }

    #[test]
    fn every_spelling_of_a_header_is_accepted(
        source in prop::option::of(prop_oneof![Just("SOUR"), Just("source")]),
        level in prop::option::of(prop_oneof![Just("LEV"), Just("Level")]),
        lower in any::<bool>(),
        colon in any::<bool>(),
    ) {
        let mut words: Vec<&str> = source.into_iter().collect();
        words.push(if lower { "current" } else { "CURR" });
        words.extend(level);
        let header = format!("{}{}", if colon { ":" } else { "" }, words.join(":"));
        let call = parse_message(&header).remove(0).unwrap();
        prop_assert!(call.is("[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]"), "{}", header);
    }
}
