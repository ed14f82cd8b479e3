//! Arbitrary bytes as the `a{sv}` that a client ends its call with: the bus library reads or refuses them, and whatever
//! it has read is asked for by every type. Nothing panics, every refusal names its key, and what is read is written so
//! that it is read the same again. The bytes come once as they are and once behind the length they have.

#![no_main]

use dbus::{MEASURING_OPTIONS, Options};
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
    if let Err(refusal) = options.only(&MEASURING_OPTIONS) {
        assert!(refusal.to_string().contains("there is no option"));
    }
    for key in options.0.keys() {
        let number = options.number(key);
        let whole = options.whole(key);
        assert!(number.as_ref().is_ok_and(Option::is_some) || whole.is_err());
        if let Ok(Some(number)) = number {
            assert!(number.is_finite());
        }
        let refusals = [
            whole.err(),
            options.text(key).err(),
            options.texts(key).err(),
            options.flag(key).err(),
        ];
        let refused = refusals.iter().flatten().count();
        // A value is of one type at most.
        assert!(refused >= 3);
        for refusal in refusals.iter().flatten() {
            assert!(refusal.to_string().contains(&format!("'{key}'")));
        }
    }
    assert!(
        options
            .number("no such key")
            .is_ok_and(|number| number.is_none())
            || options.0.contains_key("no such key")
    );
}
