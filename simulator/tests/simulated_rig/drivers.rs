//! The real drivers on the simulated rig.

use std::time::Duration;

use chrono::{DateTime, Utc};
use gpio_mux::GpioMux;
use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use rig::{
    AcquireError, BoxStream, Clock, CurrentSource, Link, MeterSettings, Rig, Stop, Switch,
    Voltmeter, acquire,
};
use simulator::{Instrument, Pace, Profile, SimulatedRig};
use survey::{Amps, Frame, Plan, Protocol, Volts, Wiring};

const DEADLINE: Duration = Duration::from_secs(20);

pub const METER: MeterSettings = MeterSettings::new(Volts(1.0), 1.0);

/// A clock that stands still: tests use the instruments' clock.
pub struct Frozen;

impl Clock for Frozen {
    fn monotonic(&self) -> Duration {
        Duration::ZERO
    }
    fn wall(&self) -> DateTime<Utc> {
        DateTime::UNIX_EPOCH
    }
}

pub fn simulated(profile: &str, scene: phantom::Scene) -> SimulatedRig {
    let profile = Profile::shipped(profile).unwrap().at_pace(Pace::Instant);
    SimulatedRig::new(&profile, scene).unwrap()
}

pub fn link(stream: BoxStream, instrument: &str) -> Link<BoxStream> {
    Link::new(stream, instrument, DEADLINE)
}

pub async fn source(simulated: &SimulatedRig) -> Keithley6221<BoxStream> {
    Keithley6221::connect(link(simulated.connect(Instrument::Source), "6221"))
        .await
        .unwrap()
}

pub async fn mainframe(simulated: &SimulatedRig) -> Keysight34980a<BoxStream> {
    Keysight34980a::connect(link(simulated.connect(Instrument::Mainframe), "34980A"))
        .await
        .unwrap()
}

pub async fn board(simulated: &SimulatedRig) -> GpioMux<BoxStream> {
    GpioMux::connect(link(simulated.connect(Instrument::Board), "board"))
        .await
        .unwrap()
}

/// Pairs or matrix: the mainframe switches and measures.
pub async fn mainframe_rig(
    simulated: &SimulatedRig,
) -> Rig<Keithley6221<BoxStream>, Keysight34980a<BoxStream>, Keysight34980a<BoxStream>> {
    let mainframe = mainframe(simulated).await;
    Rig::new(source(simulated).await, mainframe.clone(), mainframe).as_simulated(true)
}

/// The board switches, the mainframe measures.
pub async fn board_rig(
    simulated: &SimulatedRig,
) -> Rig<Keithley6221<BoxStream>, GpioMux<BoxStream>, Keysight34980a<BoxStream>> {
    Rig::new(
        source(simulated).await,
        board(simulated).await,
        mainframe(simulated).await,
    )
    .as_simulated(true)
}

pub fn plan(wiring: &Wiring) -> Plan {
    let protocol = Protocol::sheffield(26).unwrap();
    Plan::new(&protocol, wiring, Amps(1e-3), Volts(4.0), Duration::ZERO).unwrap()
}

pub async fn frame<C, W, V>(rig: &Rig<C, W, V>, wiring: &Wiring) -> Result<Frame, AcquireError>
where
    C: CurrentSource + 'static,
    W: Switch + 'static,
    V: Voltmeter + 'static,
{
    acquire(rig, &plan(wiring), METER, Frozen, &Stop::never()).await
}
