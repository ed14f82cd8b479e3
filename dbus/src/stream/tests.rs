use super::*;

fn records() -> Vec<Record> {
    let record = |sequence, body| Record {
        sequence,
        wall_ns: -5,
        gap: sequence,
        simulated: sequence % 2 == 0,
        body,
    };
    vec![
        record(
            1,
            Body::Frame {
                volts: vec![1.0, -0.0, 3e-300],
                flags: vec![0, 0, 0],
            },
        ),
        record(
            2,
            Body::Map {
                values: vec![-0.5; 7],
                mesh_hash: "abc".into(),
                method: "one-step, λ".into(),
            },
        ),
        record(2, Body::Quality { json: "{}".into() }),
        record(2, Body::Tracked { json: "{}".into() }),
        record(
            3,
            Body::Injection {
                values: vec![0.0, -0.5],
                json: "{}".into(),
            },
        ),
        record(
            2,
            Body::Deviation {
                values: vec![0.05, 0.5],
                mesh_hash: "abc".into(),
            },
        ),
        record(
            2,
            Body::Pressure {
                kpa: vec![0.0, 12.5],
                newtons: 19.6,
            },
        ),
        record(
            3,
            Body::End {
                reason: "stopped".into(),
            },
        ),
    ]
}

#[test]
fn records_survive_any_splitting() {
    let bytes: Vec<u8> = records().iter().flat_map(Record::encode).collect();
    for size in [1, 3, 39, 40, 41, bytes.len()] {
        let mut decoder = Decoder::new();
        let mut got = Vec::new();
        for piece in bytes.chunks(size) {
            decoder.push(piece);
            while let Some(record) = decoder.next_record().unwrap() {
                got.push(record);
            }
        }
        assert_eq!(got, records(), "pieces of {size}");
    }
}

#[test]
fn a_gap_is_written_into_a_shared_encoding() {
    let mut bytes = records()[0].encode();
    set_gap(&mut bytes, 99);
    let mut decoder = Decoder::new();
    decoder.push(&bytes);
    assert_eq!(decoder.next_record().unwrap().unwrap().gap, 99);
}

#[test]
fn an_unknown_kind_is_skipped_and_a_foreign_version_refused() {
    let mut strange = records()[3].encode();
    strange[6] = 200;
    let mut decoder = Decoder::new();
    decoder.push(&strange);
    decoder.push(&records()[0].encode());
    assert_eq!(decoder.next_record().unwrap().unwrap().sequence, 1);

    let mut foreign = records()[0].encode();
    foreign[4] = 9;
    let mut decoder = Decoder::new();
    decoder.push(&foreign);
    assert_eq!(decoder.next_record(), Err(StreamError::Version(9)));
}

#[test]
fn lying_counts_and_lengths_are_refused() {
    for record in records() {
        let mut bytes = record.encode();
        bytes[36] = bytes[36].wrapping_add(1);
        let mut decoder = Decoder::new();
        decoder.push(&bytes);
        assert!(decoder.next_record().is_err());
    }
    let mut decoder = Decoder::new();
    decoder.push(&[0xff; 64]);
    assert!(matches!(decoder.next_record(), Err(StreamError::Length(_))));
}
