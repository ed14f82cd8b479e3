use super::*;

fn module(text: &str) -> Module {
    text.parse().unwrap()
}

#[test]
fn every_module_has_the_channels_of_the_table() {
    for (text, channels) in [
        ("34921A", 40 + 4 + 8),
        ("34922A", 70 + 8),
        ("34923A", 40 + 8),
        ("34924A", 70 + 8),
        ("34925A", 40 + 8),
        ("34931A", 64 + 4),
        ("34932A", 128 + 4),
        ("34933A", 64 + 4),
        ("34933A,1-wire", 128),
        ("34934A,4x32", 512),
        ("34934A,4x64", 512),
        ("34934A,4x128", 512),
        ("34934A,8x32", 512),
        ("34934A,8x64", 512),
        ("34934A,16x32", 512),
        ("34934A,none", 0),
    ] {
        assert_eq!(module(text).channels().count(), channels, "{text}");
    }
}

#[test]
fn banks_rows_and_bus_relays_are_those_of_the_table() {
    let reed = module("34924A");
    assert_eq!(reed.contact(35), Some(Contact::Channel { bank: 1 }));
    assert_eq!(reed.contact(36), Some(Contact::Channel { bank: 2 }));
    assert_eq!(reed.contact(71), None);
    assert_eq!(reed.bus_relay(1, 1), Some(911));
    let cross = |matrix, row, column| {
        Some(Contact::Cross {
            matrix,
            row,
            column,
        })
    };
    let matrix = module("34932A,4x32");
    assert_eq!(matrix.contact(116), cross(1, 1, 16));
    assert_eq!(matrix.contact(501), cross(2, 5, 1));
    assert_eq!(matrix.contact(117), None);
    assert_eq!(matrix.contact(911), None);
    assert!(matrix.contact(921).is_some());
    assert!(!matrix.scannable(101));
    // 100(2R-1)+C, plus 32 for M2H: row 3, column 5 of M2H
    assert_eq!(module("34934A,4x32").contact(537), cross(2, 3, 5));
    assert_eq!(module("34934A,4x128").contact(726), cross(1, 4, 26));
    assert_eq!(module("34934A,8x32").contact(833), cross(2, 8, 1));
    assert_eq!(module("34934A,16x32").contact(882), cross(1, 16, 32));
    assert_eq!(module("34934A,16x32").contact(883), None);
}

#[test]
fn coils_are_counted() {
    let reed = module("34924A");
    assert_eq!(reed.check_closed(1..=10), Ok(()));
    assert!(reed.check_closed(1..=11).is_err());
    assert!(reed.check_closed((1..=10).chain([911])).is_err());
    assert_eq!(reed.check_closed((1..=10).chain(36..=45)), Ok(()));
    assert_eq!(module("34922A").check_closed(1..=70), Ok(()));
    assert_eq!(module("34925A").check_closed([1, 21, 911]), Ok(()));
    assert!(module("34925A").check_closed([1, 2]).is_err());
}

#[test]
fn a_terminal_that_does_not_fit_is_refused_by_name() {
    let refusal = "34924A,4x32".parse::<Module>().unwrap_err();
    assert_eq!(
        refusal.to_string(),
        "a 34924A takes no terminal '4x32'; it takes plain, none"
    );
    assert!("34999A".parse::<Module>().is_err());
    assert!("34934A,7x7".parse::<Module>().is_err());
    for model in Model::ALL {
        let module = Module::new(model);
        assert_eq!(module.to_string().parse(), Ok(module));
        assert_eq!(Module::from_card_type(&module.card_type()), Ok(module));
    }
}

#[test]
fn the_low_side_of_a_two_wire_matrix_is_found() {
    // M1H with M1L, M2H with M2L; MH with ML.
    assert_eq!(module("34934A,4x32").pair(103), Some(167));
    assert_eq!(module("34934A,4x32").pair(135), Some(199));
    assert_eq!(module("34934A,4x32").pair(167), None);
    assert_eq!(module("34934A,4x64").pair(101), Some(165));
    assert_eq!(module("34934A,8x32").pair(832), Some(864));
    for one_wire in ["34934A,8x64", "34934A,4x128", "34934A,16x32", "34932A,4x32"] {
        let module = module(one_wire);
        assert!(
            module
                .channels()
                .all(|channel| module.pair(channel).is_none())
        );
    }
}

#[test]
fn terminals_have_names() {
    for (text, name) in [
        ("34934A,8x64", "R8_R64"),
        ("34934A,none", "NONE"),
        ("34924A,none", "NONE"),
        ("34924A", "34924T"),
        ("34932A,4x32", "R4_R32"),
    ] {
        assert_eq!(module(text).terminal_type(), name);
    }
}
