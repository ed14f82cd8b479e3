//! The raw sockets of the instruments, which clients connect to by TCP.

use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

use crate::instrument::{Instrument, SecondClient};
use crate::simulated_rig::SimulatedRig;
use crate::transport::client::End;

/// Waits for a client of a port without timeout.
pub(crate) async fn next_client(port: &str, listener: &TcpListener) -> (TcpStream, String) {
    loop {
        match listener.accept().await {
            Ok((stream, address)) => {
                stream.set_nodelay(true).ok();
                return (stream, address.to_string());
            }
            Err(fault) => {
                tracing::warn!("a client of the {port} could not be accepted: {fault}");
                // out of descriptors: retry after a moment
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// Serves the port; the source's clients according to its profile.
pub(crate) async fn serve(rig: SimulatedRig, instrument: Instrument, listener: TcpListener) {
    if instrument == Instrument::Source
        && rig.source_profile().second_client != SecondClient::Served
    {
        return accept_one(rig, instrument, listener).await;
    }
    accept(rig, instrument, listener).await;
}

/// Accepts several clients at once.
async fn accept(rig: SimulatedRig, instrument: Instrument, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        let (stream, address) = next_client(&instrument.to_string(), &listener).await;
        clients.spawn(rig.clone().converse(instrument, address, stream));
        while clients.try_join_next().is_some() {}
    }
}

/// Accepts one client at a time.
async fn accept_one(rig: SimulatedRig, instrument: Instrument, listener: TcpListener) {
    loop {
        let (stream, address) = next_client(&instrument.to_string(), &listener).await;
        let served = async {
            let end = rig.clone().converse(instrument, address, stream).await;
            if end == End::Abnormal {
                let hold = rig.source_profile().slot_hold_s;
                // The range was checked when the profile was read.
                tokio::time::sleep(Duration::try_from_secs_f64(hold).unwrap_or_default()).await;
            }
        };
        if rig.source_profile().second_client == SecondClient::Held {
            served.await;
            continue;
        }
        let refuse = async {
            loop {
                let (second, address) = next_client(&instrument.to_string(), &listener).await;
                tracing::warn!("{address} is refused: the {instrument} has a client");
                // Closed with a reset: its messages are not received.
                second.set_zero_linger().ok();
            }
        };
        tokio::select! {
            () = served => {}
            () = refuse => {}
        }
    }
}
