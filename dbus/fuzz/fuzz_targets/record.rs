//! Arbitrary bytes at the decoder of the full-rate stream, whole and cut in two: nothing panics, the cut changes
//! nothing, and a decoded record that is encoded decodes to the same record again. Each input is used once as it is and
//! once preceded by a valid header, because the fuzzer would take long to guess the length.

#![no_main]

use dbus::stream::{Decoder, Record, StreamError, VERSION, set_gap};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((&[kind, count, cut, sequence], bytes)) = bytes.split_first_chunk() else {
        return;
    };
    read_twice(bytes, usize::from(cut));

    let sequence = u64::from(sequence);
    let mut framed = Vec::with_capacity(40 + bytes.len());
    framed.extend((36 + bytes.len() as u32).to_le_bytes());
    framed.extend(VERSION.to_le_bytes());
    framed.extend(u16::from(kind % 10).to_le_bytes());
    framed.extend(sequence.to_le_bytes());
    framed.extend(sequence.rotate_right(5).to_le_bytes());
    framed.extend(u64::from(cut).to_le_bytes());
    framed.extend(u32::from(count & 1).to_le_bytes());
    // The count that fits the length, or a count from the fuzzer's input.
    let fitting = match kind % 10 {
        1 => bytes.len() / 9,
        3 | 5 | 6 | 7 => bytes.len(),
        4 => (bytes.len() / 8).saturating_sub(1),
        _ => usize::from(count),
    };
    let count = if count == 255 {
        usize::from(cut)
    } else {
        fitting
    };
    framed.extend((count as u32).to_le_bytes());
    framed.extend(bytes);
    read_twice(&framed, usize::from(cut));
});

fn read_twice(bytes: &[u8], cut: usize) {
    let whole = read(&[bytes]);
    let (before, after) = bytes.split_at(cut.min(bytes.len()));
    let (records, end) = read(&[before, after]);
    assert_eq!(written(&records), written(&whole.0));
    assert_eq!(end, whole.1);
    for record in &records {
        let again = read(&[&record.encode()]);
        assert_eq!(again.1, None, "{record:?}");
        assert_eq!(written(&again.0), record.encode());
        let mut late = record.encode();
        set_gap(&mut late, u64::MAX);
        let (late, _) = read(&[&late]);
        assert_eq!(late[0].gap, u64::MAX);
        assert_eq!(late[0].sequence, record.sequence);
    }
}

fn read(pieces: &[&[u8]]) -> (Vec<Record>, Option<StreamError>) {
    let mut decoder = Decoder::new();
    let mut records = Vec::new();
    for piece in pieces {
        decoder.push(piece);
        loop {
            match decoder.next_record() {
                Ok(Some(record)) => records.push(record),
                Ok(None) => break,
                Err(refusal) => return (records, Some(refusal)),
            }
        }
    }
    (records, None)
}

/// Compares the encoded bytes: NaN, which a frame holds where it has no voltage, is not equal to itself.
fn written(records: &[Record]) -> Vec<u8> {
    records.iter().flat_map(Record::encode).collect()
}
