use super::*;

fn study(seed: u64) -> Study<'static> {
    Study {
        name: "square",
        settings: json!({ "seed": seed }),
        items: (0..7).map(|item| format!("number {item}")).collect(),
    }
}

/// Numbers whose decimal text the JSON parser rounds.
fn compute(item: usize) -> Result<Vec<f64>, ShardError> {
    Ok(vec![(item as f64).sqrt() / 3.0, 1e-300 / 7.0])
}

fn perform(seed: u64, division: &Division) -> Result<Outcome<Vec<Vec<f64>>>, ShardError> {
    study(seed).perform(division, &StopRequest::default(), &mut compute)
}

fn all(outcome: Outcome<Vec<Vec<f64>>>) -> Vec<u64> {
    let Outcome::All(results) = outcome else {
        panic!("no results: {outcome:?}");
    };
    results.concat().into_iter().map(f64::to_bits).collect()
}

fn make(folder: &Path, of: usize) {
    for shard in Shard::all(of) {
        perform(1, &Division::Shard(shard, folder.to_owned())).unwrap();
    }
}

#[test]
fn merged_results_equal_those_of_one_process() {
    let whole = all(perform(1, &Division::Whole).unwrap());
    for of in [1, 2, 7, 9] {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path(), of);
        let merged = perform(1, &Division::Merge(of, folder.path().to_owned())).unwrap();
        assert_eq!(all(merged), whole, "{of} shards");
    }
}

#[test]
fn an_interrupted_part_continues_at_every_byte() {
    let folder = tempfile::tempdir().unwrap();
    make(folder.path(), 1);
    let whole = folder.path().join("shard-0-of-1.jsonl");
    let bytes = std::fs::read(&whole).unwrap();
    for cut in 0..=bytes.len() {
        std::fs::remove_file(&whole).unwrap();
        std::fs::write(folder.path().join("shard-0-of-1.part"), &bytes[..cut]).unwrap();
        make(folder.path(), 1);
        assert_eq!(std::fs::read(&whole).unwrap(), bytes, "cut at {cut}");
    }
}

#[test]
fn a_stop_request_leaves_a_part_that_continues() {
    let folder = tempfile::tempdir().unwrap();
    let shard = Division::Shard(Shard::WHOLE, folder.path().to_owned());
    let stop = StopRequest::default();
    let mut third = |item: usize| {
        stop.request(item == 2);
        compute(item)
    };
    let stopped = study(1).perform(&shard, &stop, &mut third).unwrap_err();
    assert!(
        matches!(stopped, ShardError::Stopped { done: 3, of: 7, .. }),
        "{stopped}"
    );
    let Outcome::Made(made) = perform(1, &shard).unwrap() else {
        panic!("no shard");
    };
    assert_eq!((made.kept, made.items), (3, 7));
}

#[test]
fn other_settings_are_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = |of: usize, index: usize| {
        let shard = Shard::all(of).nth(index).unwrap();
        Division::Shard(shard, folder.path().to_owned())
    };
    perform(1, &at(2, 0)).unwrap();
    let merge = Division::Merge(2, folder.path().to_owned());
    let missing = Division::Missing(2, folder.path().to_owned());
    // settings that differ are refused for every division of this folder, also for another shard
    for division in [at(2, 0), at(2, 1), merge, missing] {
        let refusal = perform(2, &division).unwrap_err().to_string();
        for word in ["shard-0-of-2.jsonl", "settings.seed is 1 there and 2 here"] {
            assert!(refusal.contains(word), "{refusal}");
        }
    }
    assert!(!folder.path().join("shard-1-of-2.part").exists());
}

#[test]
fn absent_and_damaged_shards_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let merge = Division::Merge(3, folder.path().to_owned());
    let shard = Shard::all(3).nth(1).unwrap();
    perform(1, &Division::Shard(shard, folder.path().to_owned())).unwrap();
    let refusal = perform(1, &merge).unwrap_err().to_string();
    assert!(
        refusal.contains("shard-0-of-3.jsonl, shard-2-of-3.jsonl"),
        "{refusal}"
    );
    let missing = perform(1, &Division::Missing(3, folder.path().to_owned())).unwrap();
    assert!(matches!(missing, Outcome::Missing(numbers) if numbers == [0, 2]));
    make(folder.path(), 3);
    all(perform(1, &merge).unwrap());
    let path = folder.path().join("shard-2-of-3.jsonl");
    let text = std::fs::read_to_string(&path).unwrap();
    for damaged in [
        text.replacen("\"f64\":\"0.", "\"f64\":\"1.", 1),
        text[..text.len() - 1].to_owned(),
        text.replacen("number 5", "number 6", 1),
    ] {
        std::fs::write(&path, damaged).unwrap();
        let refusal = perform(1, &merge).unwrap_err().to_string();
        assert!(refusal.contains("shard-2-of-3.jsonl"), "{refusal}");
    }
}
