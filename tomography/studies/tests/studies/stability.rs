//! The hard cases by number: each result satisfies its bound, and the naive implementation violates it, unless the case
//! states why there is none.

use serde_json::Value;
use shards::{Division, Outcome, StopRequest};
use studies::stability;

/// Lines of the table for one case.
fn found(number: u8) -> Vec<Value> {
    let whole = stability::run(&[number], &Division::Whole, &StopRequest::default());
    let Ok(Outcome::All(table)) = whole else {
        panic!("no table: {whole:?}");
    };
    println!("{}", table.text());
    assert!(table.broken().is_empty());
    table.lines()
}

fn holds(number: u8) {
    let lines = found(number);
    assert!(!lines.is_empty());
    for line in lines {
        assert_eq!(line["case"], number);
        assert_eq!(line["verdict"], "holds", "{line}");
        let figure = |key: &str| line[key].as_f64();
        let (ours, bound) = (figure("ours").unwrap(), figure("bound").unwrap());
        let within = |figure: f64| match line["side"].as_str() {
            Some("at most") => figure <= bound,
            Some("at least") => figure >= bound,
            side => panic!("{side:?}"),
        };
        assert!(within(ours), "{line}");
        match (line["naive_breaks"].as_bool(), figure("naive")) {
            (Some(true), Some(naive)) => assert!(!within(naive), "{line}"),
            // a text instead of a number describes how the naive form fails
            (Some(true), None) => assert!(line["naive"].is_string(), "{line}"),
            // a text states why there is no naive form
            (None, naive) => assert!(naive.is_none() && line["naive"].is_string(), "{line}"),
            (Some(false), _) => panic!("{line}"),
        }
    }
}

macro_rules! cases {
    ($($name:ident $number:literal)*) => { $(
        #[test]
        fn $name() {
            holds($number);
        }
    )* };
}

cases! {
    case_01_no_conductance 1
    case_02_insulating_contrast 2
    case_03_conductive_contrast 3
    case_04_single_precision 4
    case_05_vanishing_contact 5
    case_06_open_contact 6
    case_07_floating_potential 7
    case_08_units 8
    case_09_slivers 9
    case_10_narrow_electrode 10
    case_11_electrode_edge_singularity 11
    case_12_absolute_and_difference_error 12
    case_13_sensitivity 13
    case_14_rank_deficient_sensitivity 14
    case_15_ends_of_lambda 15
    case_16_total_variation_without_beta 16
    case_17_unequal_triangles 17
    case_18_step_too_long 18
    case_19_flat_limit 19
    case_20_duplicate_centres 20
    case_21_heavy_tails 21
    case_22_pairwise_distances 22
    case_23_near_duplicates 23
    case_24_exp_underflow 24
    case_25_constant_channel 25
    case_26_relative_scales 26
    case_27_saturated_neurons 27
    case_28_training_divergence 28
    case_29_precision_of_weights 29
    case_30_no_number 30
    case_31_open_electrode 31
    case_32_tiny_baseline 32
    case_33_sign_of_readings 33
    case_34_one_bad_channel 34
    case_35_threads 35
    case_36_hot_spots 36
    case_37_dose 37
    case_38_degenerate_polygons 38
    case_39_baseline_equals_load 39
    case_40_viscoelastic_step 40
}
