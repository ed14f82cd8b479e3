//! Frame times by the instruments' clock: plans run by the real drivers on simulators in instant time.

use std::time::Duration;

use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use phantom::Scene;
use rig::{BoxStream, Link, MeterSettings, Rig, Stop, SystemClock, acquire};
use survey::{Plan, Volts};
use tokio::runtime::Runtime;

use crate::instrument::{Instrument, Pace, Profile};
use crate::simulated_rig::SimulatedRig;

/// Replies are immediate; the timeout only ends a hang.
const DEADLINE: Duration = Duration::from_secs(60);

/// A 6221 and a 34980A whose only delays are those of relays and readings.
///
/// ```
/// use std::time::Duration;
/// use simulator::{FrameTimes, Profile};
/// use survey::{Amps, Plan, Protocol, Timing, Volts, Wiring};
/// let mut times = FrameTimes::new(&Profile::default(), phantom::Scene::quiet())?;
/// let wiring = keysight_34980a::pairs_34924a(1, 26)?;
/// let plan = Plan::new(&Protocol::sheffield(26)?, &wiring, Amps(1e-3), Volts(4.0), Duration::ZERO)?;
/// let took = times.of(&plan, 1.0, 1)?.as_secs_f64();
/// let formula = plan.duration(&keysight_34980a::Model::M34924A.timing(1.0, 50.0)).as_secs_f64();
/// assert!((took / formula - 1.0).abs() < 0.01, "{took} s against {formula} s");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct FrameTimes {
    runtime: Runtime,
    simulated: SimulatedRig,
    rig: Rig<Keithley6221<BoxStream>, Keysight34980a<BoxStream>, Keysight34980a<BoxStream>>,
}

/// Errors of frame times.
#[derive(Debug, thiserror::Error)]
pub enum FrameTimeError {
    /// No runtime to run the drivers in.
    #[error("no runtime for the drivers")]
    Runtime(#[from] std::io::Error),
    /// The sheet or the slots were refused.
    #[error("the simulated rig is refused")]
    Rig(#[from] crate::RigError),
    /// A driver failed to connect.
    #[error("a simulated instrument is refused by its driver")]
    Driver(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The plan failed.
    #[error("the plan failed")]
    Frame(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl FrameTimes {
    /// Instruments of a profile with the sheet of a scene, without the profile's times for commands.
    ///
    /// # Errors
    /// The refusal, with its source.
    pub fn new(profile: &Profile, scene: Scene) -> Result<Self, FrameTimeError> {
        let mut profile = profile.clone().at_pace(Pace::Instant);
        profile.source.command_ms = 0.0;
        profile.mainframe.command_ms = 0.0;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let (simulated, rig) = runtime.block_on(async {
            let simulated = SimulatedRig::new(&profile, scene)?;
            let link = |stream, name: &str| Link::new(stream, name, DEADLINE);
            let source = Keithley6221::connect(link(simulated.connect(Instrument::Source), "6221"))
                .await
                .map_err(|fault| FrameTimeError::Driver(Box::new(fault)))?;
            let mainframe =
                Keysight34980a::connect(link(simulated.connect(Instrument::Mainframe), "34980A"))
                    .await
                    .map_err(|fault| FrameTimeError::Driver(Box::new(fault)))?;
            let rig = Rig::new(source, mainframe.clone(), mainframe).as_simulated(true);
            Ok::<_, FrameTimeError>((simulated, rig))
        })?;
        Ok(Self {
            runtime,
            simulated,
            rig,
        })
    }

    /// Runs the plan once, with readings on the 1 V range, and returns its duration by the instruments' clock.
    ///
    /// # Errors
    /// A plan that fails.
    pub fn of(
        &mut self,
        plan: &Plan,
        nplc: f64,
        averages: u32,
    ) -> Result<Duration, FrameTimeError> {
        let meter = MeterSettings {
            averages,
            ..MeterSettings::new(Volts(1.0), nplc)
        };
        let before = self.simulated.now();
        let stop = Stop::never();
        let frame = acquire(&self.rig, plan, meter, SystemClock::new(), &stop);
        self.runtime
            .block_on(frame)
            .map_err(|fault| FrameTimeError::Frame(Box::new(fault)))?;
        Ok(self.simulated.now() - before)
    }
}
