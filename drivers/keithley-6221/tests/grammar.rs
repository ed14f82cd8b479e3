//! The simulator accepts every command that the driver can send.

use keithley_6221::{
    Address, Ask, Board, Command, DeltaMode, Element, Kind, Line, List, Parameter, Shield, Speed,
    StatusGroup,
};
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
        Command::Save(0),
        Command::Recall(4),
        Command::Options,
        Command::ArmSweep,
        Command::SweepArmed,
        Command::AbortSweep,
        Command::Initiate,
        Command::Abort,
        Command::SignalArm,
        Command::SignalTrigger,
        Command::ArmWave,
        Command::StartWave,
        Command::AbortWave,
        Command::CopyWave(3),
        Command::LatestReading,
        Command::FreshReading,
        Command::SerialSend("SENS:VOLT:RANG 10; a \"quoted\" word".to_owned()),
        Command::SerialEnter,
        Command::ClearBuffer,
        Command::BufferData,
        Command::BufferLength,
        Command::BufferFree,
        Command::BufferType,
        Command::SetElements(vec![Element::Reading, Element::Source]),
        Command::Elements,
        Command::Preset,
        Command::Local,
        Command::Remote,
        Command::Beep {
            hertz: 440.0,
            seconds: 0.25,
        },
        Command::MathReading,
        Command::MakeStatistic,
        Command::StatisticReading,
        Command::LimitFailed,
        Command::EnableErrors(vec![[-440, -100], [900, 900]]),
        Command::DisableErrors(vec![[-113, -113]]),
        Command::EnabledErrors,
        Command::DisabledErrors,
        Command::SetText(Line::Upper, "a \"b\"".to_owned()),
        Command::Text(Line::Lower),
        Command::TextAttributes(Line::Upper),
        Command::SaveAddresses,
        Command::BoardSerial(Board::Analogue),
        Command::BoardRevision(Board::Digital),
    ];
    for mode in [DeltaMode::Delta, DeltaMode::Conductance, DeltaMode::Pulse] {
        commands.extend([
            Command::DeltaPresent(mode),
            Command::ArmDelta(mode),
            Command::DeltaArmed(mode),
        ]);
    }
    for address in [Address::Own, Address::Mask, Address::Gateway] {
        let address_to_set = std::net::Ipv4Addr::new(10, 0, 0, 7);
        commands.extend([
            Command::SetAddress(address, address_to_set),
            Command::Address(address),
        ]);
    }
    for list in [List::Levels, List::Delays, List::Limits, List::Wave] {
        commands.extend([
            Command::SetList(list, vec![0.1, 0.1]),
            Command::AppendList(list, vec![0.1]),
            Command::List(list),
            Command::ListLength(list),
        ]);
    }
    for &parameter in Parameter::ALL {
        let kind = parameter.kind();
        commands.push(Command::SetParameter(parameter, kind.reset_value()));
        commands.push(Command::Parameter(parameter, Ask::Now));
        match kind {
            Kind::Real { limits, .. } | Kind::Whole { limits, .. } => {
                commands.extend(limits.map(|value| Command::SetParameter(parameter, value)));
                commands.extend(asks.map(|ask| Command::Parameter(parameter, ask)));
            }
            Kind::Switch(_) => commands.push(Command::SetParameter(parameter, 1.0)),
            Kind::Choice(words) => {
                let places = (0u8..).map(f64::from).take(words.len());
                commands.extend(places.map(|at| Command::SetParameter(parameter, at)));
            }
        }
    }
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
fn commands_of_the_driver_are_parsed_by_the_simulator() {
    for command in every_command() {
        assert_eq!(
            command.to_string().parse().as_ref(),
            Ok(&command),
            "{command}"
        );
        assert_eq!(
            command.is_query(),
            command.to_string().contains('?'),
            "{command}"
        );
    }
}

#[test]
fn a_message_of_all_commands_is_parsed_as_those_commands() {
    let sent = every_command();
    let received: Vec<Command> = parse_message(scpi::join_units(&sent))
        .iter()
        .map(|call| Command::of(call.as_ref().unwrap()).unwrap())
        .collect();
    assert_eq!(received, sent);
}

#[test]
fn long_forms_and_units_are_parsed() {
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
            "source:wave:function sinusoid",
            Command::SetParameter(Parameter::Function, 0.0),
        ),
        (
            "SOUR:WAVE:FUNC arb4",
            Command::SetParameter(Parameter::Function, 7.0),
        ),
        (
            "sour:curr:swe:coun inf",
            Command::SetParameter(Parameter::Count, f64::INFINITY),
        ),
        (
            "SOUR:WAVE:DUR:TIME 100 ns",
            Command::SetParameter(Parameter::WaveTime, 100e-9),
        ),
        (
            "TRIG:SEQ:LAY:TCON:OUTP delay",
            Command::SetParameter(Parameter::TriggerOutput, 2.0),
        ),
        (
            "FORM:ELEM TST,READ",
            Command::SetElements(Element::DEFAULT.to_vec()),
        ),
        ("init", Command::Initiate),
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
        ("TRIG:SOUR BUS", ParseError::IllegalParameter),
        ("SOUR:SWE:COUN 10000", ParseError::OutOfRange),
        ("SOUR:SWE:POIN INF", ParseError::OutOfRange),
        ("SOUR:WAVE:FUNC? MIN", ParseError::ParameterNotAllowed),
        ("SOUR:WAVE:ARB:COPY 0", ParseError::OutOfRange),
        ("SOUR:WAVE:ARB:DATA 1.01", ParseError::OutOfRange),
        ("SOUR:LIST:CURR", ParseError::MissingParameter),
        ("SYST:BEEP 440", ParseError::MissingParameter),
        ("SYST:BEEP 64,1", ParseError::OutOfRange),
        ("SYST:COMM:ETH:ADDR \"1.2.3\"", ParseError::IllegalParameter),
        ("FORM:ELEM TIME", ParseError::IllegalParameter),
        ("*SAV 5", ParseError::OutOfRange),
    ] {
        assert_eq!(text.parse::<Command>(), Err(refusal), "{text}");
    }
}

/// Whether this value is within the limits of a kind.
fn allows(kind: Kind, value: f64) -> bool {
    let within = |[min, max, _]: [f64; 3], endless| {
        (min..=max).contains(&value) || (endless && value == f64::INFINITY)
    };
    match kind {
        Kind::Real {
            limits, endless, ..
        } => within(limits, endless),
        Kind::Whole { limits, endless } => within(limits, endless) && value == value.round(),
        Kind::Switch(_) => value == 0.0 || value == 1.0,
        Kind::Choice(words) => value == value.round() && (0.0..words.len() as f64).contains(&value),
    }
}

proptest! {
    #[test]
    fn levels_are_sent_to_the_last_bit(level in -0.105f64..=0.105, limit in 0.1f64..=105.0) {
        for command in [
            Command::SetLevel(Amps(level)),
            Command::SetRange(Amps(level)),
            Command::SetCompliance(Volts(limit)),
        ] {
            prop_assert_eq!(command.to_string().parse(), Ok(command));
        }
    }

    #[test]
    fn what_a_kind_hears_it_allows(at in 0..Parameter::ALL.len(), text in "(-?[0-9]{1,3}(\\.[0-9])?(e-?[0-9])?|INF|MIN|MAX|DEF|ON|[A-Z]{3,4}[0-9]?)") {
        let kind = Parameter::ALL[at].kind();
        let argument = parse_message(format!("X {text}"))[0].clone().unwrap().arguments.remove(0);
        if let Ok(value) = kind.read(&argument) {
            prop_assert!(allows(kind, value), "{text} gives {value}");
        }
    }
}
