//! What the driver can say, the simulator hears.

use keithley_6221::{Ask, Command, Message, Shield, Speed, StatusGroup};
use proptest::prelude::*;
use scpi::{Common, ParseError, parse_message};
use survey::{Amps, Volts};

fn every_command() -> Vec<Command> {
    let asks = [Ask::Now, Ask::Min, Ask::Max, Ask::Def];
    let groups = [
        StatusGroup::Measurement,
        StatusGroup::Operation,
        StatusGroup::Questionable,
    ];
    let mut commands = vec![
        Command::Common(Common::Identify),
        Command::Common(Common::Reset),
        Command::Common(Common::ClearStatus),
        Command::Common(Common::SetEventEnable(33)),
        Command::Common(Common::EventEnable),
        Command::Common(Common::Events),
        Command::Common(Common::SetServiceEnable(1)),
        Command::Common(Common::ServiceEnable),
        Command::Common(Common::StatusByte),
        Command::Common(Common::OperationComplete),
        Command::Common(Common::WhenComplete),
        Command::Common(Common::Wait),
        Command::Common(Common::SelfTest),
        Command::SetLevel(Amps(-1.234567890123e-3)),
        Command::SetRange(Amps(2e-3)),
        Command::Autorange,
        Command::SetCompliance(Volts(4.5)),
        Command::Filter,
        Command::ClearSource,
        Command::Output,
        Command::SetShield(Shield::OutputLow),
        Command::SetShield(Shield::Guard),
        Command::Shield,
        Command::LowToEarth,
        Command::SetSpeed(Speed::Fast),
        Command::SetSpeed(Speed::Slow),
        Command::Speed,
        Command::Interlock,
        Command::PresetStatus,
        Command::NextError,
        Command::ClearErrors,
        Command::Version,
    ];
    for on in [false, true] {
        commands.extend([
            Command::SetAutorange(on),
            Command::SetFilter(on),
            Command::SetOutput(on),
            Command::SetLowToEarth(on),
        ]);
    }
    for ask in asks {
        commands.extend([
            Command::Level(ask),
            Command::Range(ask),
            Command::Compliance(ask),
        ]);
    }
    for group in groups {
        commands.extend([
            Command::Events(group),
            Command::Conditions(group),
            Command::SetEnable(group, 8),
            Command::Enable(group),
        ]);
    }
    commands
}

#[test]
fn what_the_driver_says_the_simulator_hears() {
    for said in every_command() {
        assert_eq!(said.to_string().parse(), Ok(said), "{said}");
        assert_eq!(said.is_query(), said.to_string().contains('?'), "{said}");
    }
}

#[test]
fn a_message_of_all_commands_is_heard_as_those_commands() {
    let said = every_command();
    let heard: Vec<Command> = parse_message(Message(&said).to_string())
        .iter()
        .map(|call| Command::of(call.as_ref().unwrap()).unwrap())
        .collect();
    assert_eq!(heard, said);
}

#[test]
fn long_forms_and_units_are_heard() {
    for (text, meant) in [
        (
            ":SOURCE:CURRENT:LEVEL:IMMEDIATE:AMPLITUDE 2 mA",
            Command::SetLevel(Amps(2e-3)),
        ),
        ("curr max", Command::SetLevel(Amps(0.105))),
        ("curr:rang min", Command::SetRange(Amps(2e-9))),
        (
            "CURRent:COMPliance 500 mV",
            Command::SetCompliance(Volts(0.5)),
        ),
        ("output:state on", Command::SetOutput(true)),
        ("outp:ishield guard", Command::SetShield(Shield::Guard)),
        (
            "STATUS:MEASUREMENT:EVENT?",
            Command::Events(StatusGroup::Measurement),
        ),
        ("stat:queue:next?", Command::NextError),
    ] {
        assert_eq!(text.parse(), Ok(meant), "{text}");
    }
}

#[test]
fn what_is_out_of_range_or_of_another_type_has_its_number() {
    for (text, refusal) in [
        ("CURR 0.1051", ParseError::OutOfRange),
        ("CURR INF", ParseError::OutOfRange),
        ("CURR NAN", ParseError::OutOfRange),
        ("CURR 1 V", ParseError::InvalidSuffix),
        ("CURR '1'", ParseError::StringNotAllowed),
        ("CURR? NOW", ParseError::IllegalParameter),
        ("OUTP 1 A", ParseError::SuffixNotAllowed),
        ("OUTP? 1", ParseError::ParameterNotAllowed),
        ("STAT:MEAS:ENAB 65536", ParseError::OutOfRange),
        ("STAT:MEAS 1", ParseError::UndefinedHeader),
        ("SOUR:CLE?", ParseError::UndefinedHeader),
        ("OUTP:INT:TRIP 1", ParseError::UndefinedHeader),
    ] {
        assert_eq!(text.parse::<Command>(), Err(refusal), "{text}");
    }
}

proptest! {
    #[test]
    fn levels_are_told_to_the_last_bit(level in -0.105f64..=0.105, limit in 0.1f64..=105.0) {
        for said in [
            Command::SetLevel(Amps(level)),
            Command::SetRange(Amps(level)),
            Command::SetCompliance(Volts(limit)),
        ] {
            prop_assert_eq!(said.to_string().parse(), Ok(said));
        }
    }
}
