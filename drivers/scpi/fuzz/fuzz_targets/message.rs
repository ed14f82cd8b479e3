//! Arbitrary bytes through framer, parser and reply readers: nothing panics, messages stay within the buffer, and a
//! parsed call that is written out parses to the same call again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use scpi::{
    Argument, ChannelList, Common, ErrorEntry, Framer, Pattern, Unit, parse_block, parse_message,
    parse_readings, unquote,
};

const LONGEST: usize = 256;

fuzz_target!(|bytes: &[u8]| {
    let mut framer = Framer::new(LONGEST);
    let half = bytes.len() / 2;
    framer.push(&bytes[..half]);
    framer.push(&bytes[half..]);
    let pattern = Pattern::new("[SOURce<n>]:CURRent[:LEVel][:IMMediate][:AMPLitude]");
    for message in framer.flatten() {
        assert!(message.len() <= LONGEST);
        for call in parse_message(&message).into_iter().flatten() {
            pattern.suffixes(&call);
            let _ = Common::of(&call);
            for argument in &call.arguments {
                read(argument);
            }
        }
        let text = String::from_utf8_lossy(&message);
        let _ = parse_readings(&text);
        let _ = parse_block(&message);
        let _ = unquote(&text);
        let _ = text.parse::<ErrorEntry>();
    }
});

fn read(argument: &Argument) {
    let _ = argument.number(Unit::Ampere);
    let _ = argument.integer(0, 65535);
    let _ = argument.boolean();
    let _ = argument.choice(&[("OLOW", 1), ("GUARd", 2)]);
    if let Ok(list) = argument.channels() {
        assert_eq!(list.to_string().parse::<ChannelList>(), Ok(list));
    }
    // A block may hold bytes that are not text.
    if !matches!(argument, Argument::Block(_)) {
        let call = parse_message(format!("X {argument}")).remove(0);
        let call = call.expect("a datum that was read is written within the grammar");
        assert_eq!(call.arguments, std::slice::from_ref(argument));
    }
}
