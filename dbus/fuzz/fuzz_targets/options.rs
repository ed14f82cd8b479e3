//! Arbitrary bytes as the final `a{sv}` of a client's call: the D-Bus library decodes or rejects them, and decoded
//! values are converted to every struct of options. Nothing panics, every error about a value names its key, and a
//! decoded value that is encoded decodes to the same value again. Each input is used once as it is and once preceded by
//! its length.

#![no_main]

use dbus::{
    DiscoverOptions, InvalidOption, ListOptions, MEASURING_OPTIONS, Options, SessionOptions,
    ShelveOptions, StreamOptions, TranscriptOptions,
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
    // zbus 6.2 accepts an array whose stated length ends after the data, and counts that length as read
    let Ok((options, _)) = Data::new(bytes, context).deserialize::<Options>() else {
        return;
    };
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
    check(options, options.read::<ShelveOptions>().err());
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
