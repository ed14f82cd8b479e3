//! Arbitrary replies at the driver of the 34980A: no panic, no endless loop, and no answer that breaks what the seam promises.

#![no_main]

use std::collections::VecDeque;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use keysight_34980a::Keysight34980a;
use libfuzzer_sys::fuzz_target;
use rig::{Link, MeterSettings, Move, Switch, Voltmeter};
use survey::{Reading, Relay, Volts, Wiring};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::runtime::{Builder, Runtime};

/// A peer that answers every message with the next line of what the fuzzer made up, and is gone after the last.
struct Peer {
    lines: VecDeque<Vec<u8>>,
    ready: VecDeque<u8>,
}

impl Peer {
    /// Beginning with these answers when the first byte is odd, so that what comes after a sound start is met, too.
    fn new(start: &[&str], bytes: &[u8]) -> Self {
        let sound = bytes.first().is_some_and(|first| first % 2 == 1);
        let start = start.iter().filter(|_| sound).map(|line| line.as_bytes().to_vec());
        let made_up = bytes.get(1..).unwrap_or_default();
        let made_up = made_up.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec);
        Self {
            lines: start.chain(made_up).collect(),
            ready: VecDeque::new(),
        }
    }
}

impl AsyncRead for Peer {
    fn poll_read(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.ready.is_empty() && !self.lines.is_empty() {
            return Poll::Pending;
        }
        while buffer.remaining() > 0 {
            let Some(byte) = self.ready.pop_front() else { break };
            buffer.put_slice(&[byte]);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Peer {
    fn poll_write(mut self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        // a line that begins with a low byte brings the next one along: an answer doubled
        while let Some(line) = self.lines.pop_front() {
            let more = line.first().is_some_and(|first| *first == 2);
            self.ready.extend(line);
            if !more {
                break;
            }
        }
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

fn runtime() -> Runtime {
    Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime needs no more than memory")
}

thread_local! {
    static RUNTIME: Runtime = runtime();
}

const START: [&str; 9] = [
    "Agilent Technologies,34980A,MY44001234,2.43-2.43-0.00-0.00\n",
    "Agilent Technologies,34924A,MY1,1.0\n",
    "\"Agilent Technologies,34934A-4x128,MY2,1.0\"\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
];
const METER: MeterSettings = MeterSettings {
    range: Volts(1.0),
    nplc: 1.0,
    autozero: false,
};

fuzz_target!(|bytes: &[u8]| {
    let link = Link::new(Peer::new(&START, bytes), "34980A", Duration::from_millis(10));
    let way = bytes.first().copied().unwrap_or(0) >> 1;
    RUNTIME.with(|runtime| {
        runtime.block_on(async {
            let Ok(mut unit) = Keysight34980a::connect(link).await else { return };
            let wiring = Wiring::pairs_34924a(1, 4).expect("four pairs fit");
            let fits = unit.check_wiring(&wiring).is_ok();
            let (inject, measure) = (wiring.injecting_relays(), wiring.measuring_relays());
            let scan = if way % 2 == 0 { measure.clone() } else { Vec::new() };
            if way % 3 == 0 {
                unit.prepare(METER, &scan).await.ok();
            }
            let moved = unit.move_relays(&[Move::Close(vec![Relay(1036)])]).await;
            assert!(moved.is_err() || fits, "a relay moved on a module that lacks it");
            if let Ok(counts) = unit.relay_cycles(&inject).await {
                assert_eq!(counts.len(), inject.len());
            }
            let readings = match scan.is_empty() {
                true => unit.read().await.map(|reading| vec![reading]),
                false => unit.scan().await,
            };
            if let Ok(readings) = readings {
                assert_eq!(readings.len(), scan.len().max(1));
                for reading in readings {
                    if let Reading::Ok(volts) = reading {
                        assert!(volts.0.is_finite() && volts.0.abs() < 1.3, "{volts}");
                    }
                }
            }
            if let Ok(states) = unit.closed(&inject).await {
                assert_eq!(states.len(), inject.len());
            }
            unit.open_verified(&inject).await.ok();
        });
    });
});
