//! The simulator parses every command that the driver writes.

use proptest::prelude::*;
use scpi::Numeric;

use super::*;
use crate::meter::{INTEGRATION, RANGES};

fn every_route(list: &ChannelList) -> Vec<Route> {
    use Route as R;
    let name = || "A_1".to_owned();
    let mut commands: Vec<Route> = [
        R::Close,
        R::CloseExclusive,
        R::ClosePair,
        R::Closed,
        R::ClosedPair,
        R::Open,
        R::OpenPair,
        R::Opened,
        R::OpenedPair,
        R::SetScan,
        R::AddScan,
        R::RemoveScan,
    ]
    .map(|command| command(list.clone()))
    .to_vec();
    commands.extend([
        R::SetScan(ChannelList::default()),
        R::OpenAll(None),
        R::OpenAll(Some(8)),
        R::OpenBuses(None),
        R::OpenBuses(Some(4)),
        R::SetOverlap(true),
        R::Overlap,
        R::ModuleBusy(None),
        R::ModuleBusy(Some(3)),
        R::ModuleWait(None),
        R::ModuleWait(Some(3)),
        R::Scan,
        R::ScanSize,
        R::SetOrdered(false),
        R::Ordered,
        R::Define {
            name: name(),
            commands: Message(vec![
                R::Close(list.clone()).into(),
                System::Delay(0.5).into(),
                System::SetDisplay("it \"runs\"".to_owned()).into(),
                R::Run(name()).into(),
            ]),
        },
        R::SetLabel("a \"b\"".to_owned(), list.clone()),
        R::Labels(list.clone()),
        R::Definition(name()),
        R::Run(name()),
        R::Delete(Some(name())),
        R::Delete(None),
        R::Catalog,
        R::SequenceBusy,
        R::SequenceWait,
        R::SequenceAbort,
    ]);
    commands
}

fn every_sense(channels: &Channels) -> Vec<Sense> {
    let channels = || channels.clone();
    let mut commands = vec![
        Sense::Configure {
            range: Range::Auto,
            resolution: None,
            channels: channels(),
        },
        Sense::Configure {
            range: Range::Fixed(10.0),
            resolution: Some(Numeric::Value(1e-4)),
            channels: channels(),
        },
        Sense::Configuration(channels()),
    ];
    let mut settings = vec![
        Setting::Range(Range::Auto),
        Setting::RangeAuto(false),
        Setting::Aperture(300e-6),
        Setting::Aperture(0.123_456),
        Setting::ApertureEnabled(true),
        Setting::Resolution(Numeric::Min),
        Setting::Resolution(Numeric::Value(1e-5)),
        Setting::Autozero(false),
        Setting::AutozeroOnce,
        Setting::InputAuto(true),
        Setting::Delay(0.002),
        Setting::DelayAuto(true),
    ];
    settings.extend(RANGES.map(|range| Setting::Range(Range::Fixed(range))));
    settings.extend(INTEGRATION.map(|(nplc, _)| Setting::Nplc(nplc)));
    for setting in settings {
        commands.push(Sense::Set(setting, channels()));
        let quantity = setting.quantity();
        commands.push(Sense::Ask(quantity, None, channels()));
        commands.push(Sense::Ask(quantity, Some(Numeric::Max), channels()));
    }
    for setting in [Setting::Autozero(true), Setting::InputAuto(false)] {
        commands.push(Sense::SetOlder(setting, channels()));
        commands.push(Sense::AskOlder(setting.quantity(), None, channels()));
    }
    commands
}

fn every_function(channels: &Channels) -> Vec<Functions> {
    use super::function::{ValueKind, details, value_kind};
    use Functions as F;
    let mut commands = Vec::new();
    for function in Function::ALL {
        commands.push(F::Select(function, channels.clone()));
        for detail in details(function) {
            let value = match value_kind(function, detail).unwrap() {
                ValueKind::Switch => vec![SettingValue::Switch(true), SettingValue::Switch(false)],
                ValueKind::Autozero => vec![SettingValue::Switch(true), SettingValue::Word("ONCE")],
                ValueKind::Range => vec![
                    SettingValue::Range(Range::Auto),
                    SettingValue::Range(Range::Fixed(function.ranges()[1])),
                ],
                ValueKind::Resolution => vec![SettingValue::Resolution(Numeric::Min)],
                ValueKind::Number(_, limits) => limits.map(SettingValue::Number).to_vec(),
                ValueKind::Step(_, steps, _) | ValueKind::OneOf(steps, _) => {
                    steps.iter().copied().map(SettingValue::Number).collect()
                }
                ValueKind::Words(words, _) => words
                    .iter()
                    .map(|(_, word)| SettingValue::Word(word))
                    .collect(),
            };
            for value in value {
                commands.push(F::Set(function, detail, value, channels.clone()));
            }
            for limit in [None, Some(Numeric::Min)] {
                commands.push(F::Ask(function, detail, limit, channels.clone()));
            }
        }
        if function == Function::DcVolts {
            continue;
        }
        let probes = match function {
            Function::Temperature => vec![
                Some(("TC", "K")),
                Some(("FRTD", "91")),
                Some(("THER", "10000")),
            ],
            _ => vec![None],
        };
        for probe in probes {
            for resolution in [None, Some(Numeric::Max)] {
                let request = MeasurementRequest {
                    function,
                    range: Range::Auto,
                    resolution,
                    probe,
                };
                commands.push(F::Configure(request, channels.clone()));
                commands.push(F::Measure(request, channels.clone()));
            }
        }
    }
    commands.push(F::Selected(channels.clone()));
    commands
}

fn every_measure(channels: &Channels) -> Vec<Measure> {
    use Measure as M;
    let mut commands = vec![
        M::Read(channels.clone()),
        M::Volts {
            range: Range::Auto,
            resolution: Some(Numeric::Max),
            channels: channels.clone(),
        },
        M::Initiate,
        M::Fetch,
        M::ReadAndErase(None),
        M::ReadAndErase(Some(10)),
        M::Remove(5),
        M::Points,
        M::Last(None),
        M::SetThreshold(100),
        M::Threshold,
        M::Abort,
        M::Source,
        M::SetTimer(0.25),
        M::Timer(None),
        M::Timer(Some(Numeric::Min)),
        M::SetCount(Some(50_000)),
        M::SetCount(None),
        M::Count(None),
        M::Count(Some(Numeric::Max)),
        M::SetSamples(500_000),
        M::Samples(None),
        M::Samples(Some(Numeric::Max)),
        M::SetTriggerDelay(Some(0.25)),
        M::SetTriggerDelay(None),
        M::TriggerDelay(Some(Numeric::Min)),
        M::TriggerDelayAuto,
        M::SetAbsoluteTime(true),
        M::SetAbsoluteTime(false),
        M::AbsoluteTime,
    ];
    for source in [
        TriggerSource::Immediate,
        TriggerSource::Bus,
        TriggerSource::External,
        TriggerSource::Timer,
        TriggerSource::Alarm(1),
        TriggerSource::Alarm(4),
    ] {
        commands.push(M::SetSource(source));
    }
    for field in [Field::Unit, Field::Time, Field::Channel, Field::Alarm] {
        commands.extend([M::SetField(field, true), M::Field(field)]);
    }
    commands
}

fn every_system(list: &ChannelList) -> Vec<System> {
    use System as S;
    let mut commands = vec![
        S::CardType(8),
        S::TerminalType(1),
        S::Protection(2),
        S::RelayCycles(list.clone()),
        S::ClearRelayCycles(list.clone()),
        S::VoltmeterInstalled,
        S::SetVoltmeter(false),
        S::Voltmeter,
        S::MemoryValid(0),
        S::MemoryDelete(5),
        S::Memories,
        S::MacAddress,
        S::NextError,
        S::Version,
        S::SetDate(2026, 11, 21),
        S::Date,
        S::SetTime(23, 59, 58.125),
        S::Time,
        S::ScanTime,
        S::RequestLock,
        S::ReleaseLock,
        S::LockName,
        S::LockOwner,
        S::Delay(0.25),
        S::SetDisplay("a; \"b\"".to_owned()),
        S::Display,
        S::ClearDisplay,
        S::SetDisplayOn(false),
        S::DisplayOn,
        S::LineFrequency,
        S::Beep,
        S::Preset,
        S::PresetStatus,
    ];
    for protection in [
        Protection::Auto100,
        Protection::Auto0,
        Protection::Fix,
        Protection::Iso,
    ] {
        commands.push(S::SetProtection(3, protection));
    }
    for group in [
        StatusGroup::Operation,
        StatusGroup::Questionable,
        StatusGroup::Alarm,
    ] {
        commands.extend([
            S::Events(group),
            S::Conditions(group),
            S::SetEnable(group, 65_535),
            S::Enable(group),
        ]);
    }
    commands
}

fn every_calculation(list: &ChannelList, channels: &Channels) -> Vec<Calculate> {
    use Calculate as C;
    let mut commands = vec![
        C::ClearStatistics(channels.clone()),
        C::SetAlarmSource(4, list.clone()),
        C::SetAlarmSource(1, ChannelList::default()),
        C::AlarmSource(2),
        C::NextAlarm,
    ];
    for scaling in [
        Scaling::Gain(-1.25e3),
        Scaling::Offset(0.1),
        Scaling::Unit("#_9".to_owned()),
        Scaling::State(true),
    ] {
        commands.push(C::SetScaling(scaling, channels.clone()));
    }
    for quantity in [
        ScalingQuantity::Gain,
        ScalingQuantity::Offset,
        ScalingQuantity::Unit,
        ScalingQuantity::State,
    ] {
        commands.push(C::Scaling(quantity, channels.clone()));
    }
    for limit in [Limit::Lower, Limit::Upper] {
        commands.extend([
            C::SetLimit(limit, Numeric::Value(2.5), list.clone()),
            C::SetLimit(limit, Numeric::Def, list.clone()),
            C::Limit(limit, None, list.clone()),
            C::Limit(limit, Some(Numeric::Min), list.clone()),
            C::SetLimitState(limit, true, list.clone()),
            C::LimitState(limit, list.clone()),
        ]);
    }
    for statistic in [
        Statistic::Minimum,
        Statistic::MinimumTime,
        Statistic::Maximum,
        Statistic::MaximumTime,
        Statistic::Average,
        Statistic::PeakToPeak,
        Statistic::Count,
    ] {
        commands.push(C::Statistic(statistic, channels.clone()));
    }
    commands
}

fn every_command() -> Vec<Command> {
    let list: ChannelList = "(@1001,1003:1010)".parse().unwrap();
    let mut commands: Vec<Command> = [
        Common::Identify,
        Common::Reset,
        Common::ClearStatus,
        Common::SetEventEnable(60),
        Common::EventEnable,
        Common::Events,
        Common::SetServiceEnable(4),
        Common::ServiceEnable,
        Common::StatusByte,
        Common::OperationComplete,
        Common::WhenComplete,
        Common::Wait,
        Common::SelfTest,
        Common::Trigger,
    ]
    .map(Command::Common)
    .to_vec();
    commands.extend(every_route(&list).into_iter().map(Command::from));
    commands.extend(every_system(&list).into_iter().map(Command::from));
    for channels in [None, Some(ChannelList::default()), Some(list.clone())] {
        let calculations = every_calculation(&list, &channels);
        commands.extend(calculations.into_iter().map(Command::from));
        commands.extend(every_sense(&channels).into_iter().map(Command::from));
        commands.extend(every_function(&channels).into_iter().map(Command::from));
        commands.extend(every_measure(&channels).into_iter().map(Command::from));
    }
    commands
}

#[test]
fn commands_of_the_driver_are_parsed_by_the_simulator() {
    for command in every_command() {
        assert_eq!(command.to_string().parse(), Ok(command));
    }
}

#[test]
fn a_whole_message_is_parsed_as_its_commands() {
    let commands = Message(every_command());
    let parsed: Vec<Command> = scpi::parse_message(commands.to_string())
        .iter()
        .map(|call| Command::of(call.as_ref().unwrap()).unwrap())
        .collect();
    assert_eq!(parsed, commands.0);
}

#[test]
fn values_become_what_the_instrument_makes_of_them() {
    let parsed = |text: &str| text.parse::<Command>();
    let set = |setting, channels: Channels| Ok(Command::from(Sense::Set(setting, channels)));
    assert_eq!(
        parsed("sense:voltage:range 0.5"),
        set(Setting::Range(Range::Fixed(1.0)), None)
    );
    assert_eq!(
        parsed("VOLT:DC:NPLC 0.5,(@1001)"),
        set(Setting::Nplc(1.0), Some(ChannelList::of([1001])))
    );
    assert_eq!(
        parsed("VOLT:APER 301.7 us"),
        set(Setting::Aperture(300e-6), None)
    );
    assert_eq!(
        parsed("ROUT:OPEN:ALL slot3"),
        Ok(Route::OpenAll(Some(3)).into())
    );
    assert_eq!(
        parsed("ROUT:OPEN:ABUS ABUS2"),
        Ok(Route::OpenBuses(Some(2)).into())
    );
    assert_eq!(
        parsed("TRIG:COUN 9.9E37"),
        Ok(Measure::SetCount(None).into())
    );
    assert_eq!(
        parsed("TRIG:COUN MAX"),
        Ok(Measure::SetCount(Some(50_000)).into())
    );
    assert_eq!(
        parsed("SYSTem:MODule:ROW:PROTection 1, AUTO100"),
        Ok(System::SetProtection(1, Protection::Auto100).into())
    );
}

#[test]
fn what_cannot_be_is_refused_by_its_own_number() {
    for (text, refusal) in [
        ("VOLT:RANG 301", ParseError::OutOfRange),
        ("VOLT:NPLC", ParseError::MissingParameter),
        ("VOLT:NPLC 1,(@1001),2", ParseError::ParameterNotAllowed),
        ("VOLT:NPLC? 3", ParseError::IllegalParameter),
        ("VOLT:APER 2", ParseError::OutOfRange),
        ("ROUT:CLOS 1001", ParseError::NumericNotAllowed),
        ("ROUT:CLOSE:NONE", ParseError::UndefinedHeader),
        ("SYST:CTYP? 9", ParseError::OutOfRange),
        ("SYST:CTYP? SLOT9", ParseError::OutOfRange),
        ("SYST:MOD:ROW:PROT 1,AUTO", ParseError::IllegalParameter),
        ("TRIG:COUN 0", ParseError::OutOfRange),
        ("TRIG:SOUR ALAR5", ParseError::IllegalParameter),
        ("CALC:SCAL:GAIN 1.1E15", ParseError::OutOfRange),
        ("CALC:SCAL:UNIT 'ABCD'", ParseError::IllegalParameter),
        ("CALC:SCAL:UNIT 'A%'", ParseError::IllegalParameter),
        ("CALC:LIM:UPP 1", ParseError::MissingParameter),
        ("OUTP:ALAR5:SOUR?", ParseError::UndefinedHeader),
        (
            "ROUT:SEQ:DEF 1A,\"ROUT:OPEN:ALL\"",
            ParseError::NumericNotAllowed,
        ),
        ("ROUT:SEQ:DEF A,\"READ?\"", ParseError::SettingsConflict),
        ("ROUT:SEQ:DEF A,\"INIT\"", ParseError::SettingsConflict),
        (
            "ROUT:SEQ:DEF A,\"ROUT:KLOS (@1001)\"",
            ParseError::UndefinedHeader,
        ),
        ("ROUT:SEQ:DEF A,\"\"", ParseError::IllegalParameter),
    ] {
        assert_eq!(text.parse::<Command>(), Err(refusal), "{text}");
    }
}

proptest! {
    #[test]
    fn every_parsed_command_parses_again_after_writing(text in "[ -~]{0,40}") {
        if let Ok(command) = text.parse::<Command>() {
            prop_assert_eq!(command.to_string().parse(), Ok(command));
        }
    }
}
