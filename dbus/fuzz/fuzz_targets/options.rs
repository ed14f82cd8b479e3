//! Arbitrary bytes as the `a{sv}` that a client ends its call with: the bus library reads or refuses them, and whatever
//! it has read is read into every struct of options. Nothing panics, every refusal of a value names its key, and what is read is written so
//! that it is read the same again. The bytes come once as they are and once behind the length they have.

#![no_main]

use dbus::{
    DiscoverOptions, InvalidOption, ListOptions, MEASURING_OPTIONS, Options, SessionOptions,
    StreamOptions, TranscriptOptions,
};
use libfuzzer_sys::fuzz_target;
use zbus::wire::serialized::{Context, Data};
use zbus::wire::{LE, to_bytes};

fuzz_target!(|bytes: &[u8]| {
    read(bytes);
    let mut framed = (bytes.len() as u32).to_le_bytes().to_vec();
    // Entries of a dictionary begin at a multiple of eight.
    framed.extend([0; 4]);
    framed.extend(bytes);
    read(&framed);
});

fn read(bytes: &[u8]) {
    let context = Context::new(LE, 0);
    let Ok((options, used)) = Data::new(bytes, context).deserialize::<Options>() else {
        return;
    };
    assert!(used <= bytes.len());
    ask(&options);
    let written = to_bytes(context, &options).expect("options that were read can be written");
    let (again, _) = written
        .deserialize::<Options>()
        .expect("options that were written can be read");
    assert_eq!(again.0.len(), options.0.len());
    ask(&again);
}

fn ask(options: &Options) {
    if let Err(error) = options.only(&MEASURING_OPTIONS) {
        assert!(error.to_string().contains("there is no option"));
    }
    check(options, options.read::<SessionOptions>().err());
    check(options, options.read::<ListOptions>().err());
    check(options, options.read::<DiscoverOptions>().err());
    check(options, options.read::<TranscriptOptions>().err());
    check(options, options.read::<StreamOptions>().err());
    for key in options.0.keys() {
        assert!(options.number(key).is_none_or(f64::is_finite));
        // a value is of one type at most
        assert!(options.number(key).is_none() || options.text(key).is_none());
    }
}

fn check(options: &Options, error: Option<InvalidOption>) {
    let Some(error) = error else {
        return;
    };
    match &error.key {
        Some(key) => {
            assert!(options.0.contains_key(key) && error.text.contains(&format!("'{key}'")));
        }
        None => assert!(error.text.contains("there is no option")),
    }
}
