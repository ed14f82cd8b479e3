//! Connections to instruments: opened by their address, with a transcript of all messages.

use std::time::Duration;

use rig::{BoxStream, Link, LinkError, RigError, RingTranscript};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::kinds::Model;
use crate::instruments::rig_plan::RigPlan;
use crate::instruments::simulation::{self, SimulatedRig};

/// Timeout of a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Why an instrument cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConnectError {
    #[error(
        "the {role} at {place} cannot be reached; check that it is switched on and that the address is right"
    )]
    Unreachable {
        role: &'static str,
        place: InstrumentAddress,
        #[source]
        cause: LinkError,
    },
    #[error("the {role} at {place}")]
    Instrument {
        role: &'static str,
        place: InstrumentAddress,
        #[source]
        cause: RigError,
    },
}

impl ConnectError {
    /// The role of the instrument.
    pub(crate) fn role(&self) -> &'static str {
        match self {
            Self::Unreachable { role, .. } | Self::Instrument { role, .. } => role,
        }
    }
}

/// Connects to the instruments of a plan.
#[derive(Clone, Copy)]
pub(crate) struct Connector<'a> {
    pub plan: &'a RigPlan,
    pub simulated_rig: Option<&'a SimulatedRig>,
    pub transcript: Option<&'a RingTranscript>,
}

/// An instrument's role in the rig and its address.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) role: &'static str,
    pub(super) address: &'a InstrumentAddress,
    /// Timeout of a reply.
    pub(super) deadline: Duration,
}

impl<'a> Connector<'a> {
    pub(super) fn source(self) -> Place<'a> {
        place("source", &self.plan.instruments.source)
    }

    pub(super) fn switch(self) -> Place<'a> {
        place("switch", &self.plan.instruments.switch)
    }

    pub(super) fn voltmeter(self) -> Place<'a> {
        place("voltmeter", &self.plan.instruments.voltmeter)
    }

    /// Opens a stream.
    pub(super) async fn open(
        self,
        place: Place<'_>,
        model: &Model,
    ) -> Result<BoxStream, ConnectError> {
        let opened = match place.address {
            InstrumentAddress::Simulated => {
                let rig = self.simulated_rig;
                let rig = rig.expect("a plan with a simulated place has a simulated rig");
                return Ok(simulation::connect(rig, model.simulated));
            }
            InstrumentAddress::Tcp(address) => rig::connect_tcp(address, CONNECT_TIMEOUT).await,
            InstrumentAddress::Serial { path, baud } => {
                rig::open_serial(path, baud.unwrap_or(model.baud))
            }
            // a gpiochip is not a stream; the configuration allows it only for a board, which is opened in
            // `multiplexer`
            InstrumentAddress::Gpiochip { path, .. } => Err(LinkError::Unreachable {
                address: path.clone(),
                cause: std::io::ErrorKind::Unsupported.into(),
            }),
        };
        opened.map_err(|cause| ConnectError::Unreachable {
            role: place.role,
            place: place.address.clone(),
            cause,
        })
    }

    /// A link over an open stream.
    pub(super) fn link(
        self,
        stream: BoxStream,
        place: Place<'_>,
        model: &Model,
    ) -> Link<BoxStream> {
        let name = format!("{} ({})", model.name, place.address);
        let link = Link::new(stream, name, place.deadline);
        match self.transcript {
            Some(transcript) => link.with_transcript(transcript.clone()),
            None => link,
        }
    }
}

impl Place<'_> {
    /// An error of the instrument in this place.
    pub(super) fn fault(self) -> impl FnOnce(RigError) -> ConnectError {
        let place = self.address.clone();
        move |cause| ConnectError::Instrument {
            role: self.role,
            place,
            cause,
        }
    }
}

fn place<'a>(role: &'static str, at: &'a (InstrumentAddress, Duration)) -> Place<'a> {
    let (address, deadline) = at;
    Place {
        role,
        address,
        deadline: *deadline,
    }
}
