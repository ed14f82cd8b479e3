//! What the driver says, the simulator hears.

use super::*;

fn every_command() -> Vec<Command> {
    use Command as C;
    let list: ChannelList = "(@1001,1003:1010)".parse().unwrap();
    let mut said: Vec<Command> = [
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
    .map(C::Common)
    .to_vec();
    said.extend([
        C::Initiate,
        C::Fetch,
        C::Abort,
        C::Close(list.clone()),
        C::CloseExclusive(list.clone()),
        C::Closed(list.clone()),
        C::Open(list.clone()),
        C::Opened(list.clone()),
        C::OpenAll(None),
        C::OpenAll(Some(8)),
        C::OpenBuses(None),
        C::OpenBuses(Some(4)),
        C::SetScan(ChannelList::default()),
        C::Scan,
        C::ScanSize,
        C::SetTriggerTimer(0.25),
        C::TriggerTimer,
        C::SetTriggerCount(50_000),
        C::TriggerCount,
        C::TriggerSource,
        C::CardType(8),
        C::NextError,
        C::Version,
        C::RelayCycles(list.clone()),
        C::PresetStatus,
    ]);
    for channels in [None, Some(ChannelList::default()), Some(list)] {
        let channels = || channels.clone();
        said.extend([
            C::Read(channels()),
            C::SetChannelDelay(0.002, channels()),
            C::ChannelDelay(channels()),
            C::SetChannelDelayAuto(true, channels()),
            C::ChannelDelayAuto(channels()),
            C::ConfigureVolts {
                range: Range::Auto,
                resolution: None,
                channels: channels(),
            },
            C::ConfigureVolts {
                range: Range::Fixed(10.0),
                resolution: Some(Numeric::Value(1e-4)),
                channels: channels(),
            },
            C::Configuration(channels()),
            C::Nplc(channels()),
            C::SetRange(Range::Auto, channels()),
            C::Range(channels()),
            C::SetRangeAuto(false, channels()),
            C::RangeAuto(channels()),
            C::SetAutozero(false, channels()),
            C::Autozero(channels()),
            C::SetInputAuto(true, channels()),
            C::InputAuto(channels()),
        ]);
        said.extend(RANGES.map(|range| C::SetRange(Range::Fixed(range), channels())));
        said.extend(INTEGRATION.map(|(nplc, _)| C::SetNplc(nplc, channels())));
    }
    said.extend(SOURCES.map(|(_, source)| C::SetTriggerSource(source)));
    for (_, field) in FIELDS {
        said.extend([C::SetField(field, true), C::Field(field)]);
    }
    for (_, group) in GROUPS {
        said.extend([
            C::Events(group),
            C::Conditions(group),
            C::SetEnable(group, 65_535),
            C::Enable(group),
        ]);
    }
    said
}

#[test]
fn what_the_driver_says_the_simulator_hears() {
    for said in every_command() {
        assert_eq!(said.to_string().parse(), Ok(said));
    }
}

#[test]
fn a_whole_message_is_heard_as_its_commands() {
    let said = Message(every_command());
    let heard: Vec<Command> = scpi::parse_message(said.to_string())
        .iter()
        .map(|call| Command::of(call.as_ref().unwrap()).unwrap())
        .collect();
    assert_eq!(heard, said.0);
}

#[test]
fn values_become_what_the_instrument_makes_of_them() {
    let heard = |text: &str| text.parse::<Command>();
    assert_eq!(
        heard("sense:voltage:range 0.5"),
        Ok(Command::SetRange(Range::Fixed(1.0), None))
    );
    assert_eq!(
        heard("VOLT:DC:NPLC 0.5,(@1001)"),
        Ok(Command::SetNplc(1.0, Some(ChannelList::of([1001]))))
    );
    assert_eq!(heard("VOLT:RANG 301"), Err(ParseError::OutOfRange));
    assert_eq!(heard("VOLT:NPLC"), Err(ParseError::MissingParameter));
    assert_eq!(
        heard("VOLT:NPLC 1,(@1001),2"),
        Err(ParseError::ParameterNotAllowed)
    );
    assert_eq!(heard("ROUT:CLOS 1001"), Err(ParseError::NumericNotAllowed));
    assert_eq!(heard("ROUT:CLOSE:NONE"), Err(ParseError::UndefinedHeader));
    assert_eq!(heard("SYST:CTYP? 9"), Err(ParseError::OutOfRange));
}
