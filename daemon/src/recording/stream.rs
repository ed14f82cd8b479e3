//! The full-rate stream: a ring and a socket for each reader. Publishing never waits.

use std::io::ErrorKind;
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use dbus::stream::{Body, Record};
use tokio::io::{AsyncWriteExt, Interest};
use tokio::net::UnixStream;
use tokio::sync::Notify;

use crate::locked::locked;
use crate::panics::containment::{PanicScope, answer};
use crate::recording::ring::Ring;

/// Time for a reader to read the remaining records after the end of the session; then its stream is closed.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(30);

/// Options of a reader.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub frames: bool,
    pub maps: bool,
    /// Only on request: old clients do not understand it.
    pub pressure: bool,
    /// Quality of maps.
    pub quality: bool,
    /// The load after every injection, which is computed only while a client reads it.
    pub injections: bool,
    /// The standard deviation of maps, which is computed only while a client reads it.
    pub deviations: bool,
    /// Maximum number of records held for the reader.
    pub ring: usize,
}

/// Every reader of one session.
#[derive(Debug, Default)]
pub(crate) struct Readers {
    open: Mutex<OpenReaders>,
}

#[derive(Debug, Default)]
struct OpenReaders {
    readers: Vec<Arc<Reader>>,
    /// The record of the session's end, once it has been sent: a reader that is added later receives it immediately.
    end: Option<Arc<[u8]>>,
}

#[derive(Debug)]
struct Reader {
    wanted: Wanted,
    waiting: Mutex<Waiting>,
    news: Notify,
    /// Notified once, when the session has ended.
    over: Notify,
}

#[derive(Debug)]
struct Waiting {
    ring: Ring,
    ended: bool,
    gone: bool,
}

impl Readers {
    /// Adds a reader and returns its end of the socket. `place` is dropped when the stream is closed. Must be called in
    /// the runtime.
    pub(crate) fn add(
        &self,
        wanted: Wanted,
        place: impl Send + 'static,
    ) -> std::io::Result<OwnedFd> {
        let (ours, theirs) = UnixStream::pair()?;
        let theirs = theirs.into_std()?;
        theirs.set_nonblocking(false)?;
        let reader = Arc::new(Reader {
            wanted,
            waiting: Mutex::new(Waiting {
                ring: Ring::new(wanted.ring),
                ended: false,
                gone: false,
            }),
            news: Notify::new(),
            over: Notify::new(),
        });
        let mut open = locked(&self.open);
        // removed here too: between two records, many readers may have connected and disconnected
        open.forget_gone();
        match &open.end {
            Some(end) => reader.end(end),
            None => open.readers.push(Arc::clone(&reader)),
        }
        drop(open);
        tokio::spawn(async move {
            // a panic is logged where it happens; the reader's stream is closed
            let _ = answer(PanicScope::Reply, serve(reader, ours)).await;
            drop(place);
        });
        Ok(theirs.into())
    }

    /// Whether there is any reader.
    pub(crate) fn is_empty(&self) -> bool {
        locked(&self.open).readers.is_empty()
    }

    /// Whether any reader has requested the load after every injection.
    pub(crate) fn want_injections(&self) -> bool {
        self.any_wants(|wanted| wanted.injections)
    }

    /// Whether any reader has requested the standard deviation of maps.
    pub(crate) fn want_deviations(&self) -> bool {
        self.any_wants(|wanted| wanted.deviations)
    }

    fn any_wants(&self, what: impl Fn(&Wanted) -> bool) -> bool {
        let wants = |reader: &Arc<Reader>| what(&reader.wanted) && !locked(&reader.waiting).gone;
        locked(&self.open).readers.iter().any(wants)
    }

    /// Sends a record to all readers that requested its kind; never waits.
    pub(crate) fn publish(&self, record: &Record) {
        let mut open = locked(&self.open);
        open.forget_gone();
        if let Body::End { .. } = record.body {
            let end: Arc<[u8]> = record.encode().into();
            for reader in open.readers.drain(..) {
                reader.end(&end);
            }
            open.end = Some(end);
            return;
        }
        if open.readers.is_empty() {
            return;
        }
        let encoded: Arc<[u8]> = record.encode().into();
        for reader in &open.readers {
            let wants = match record.body {
                Body::Frame { .. } => reader.wanted.frames,
                Body::Map { .. } => reader.wanted.maps,
                Body::Pressure { .. } => reader.wanted.pressure,
                Body::Quality { .. } | Body::Tracked { .. } | Body::Quantities { .. } => {
                    reader.wanted.quality
                }
                Body::Injection { .. } => reader.wanted.injections,
                Body::Deviation { .. } => reader.wanted.deviations,
                Body::End { .. } => true,
            };
            if wants {
                locked(&reader.waiting).ring.push(Arc::clone(&encoded));
                reader.news.notify_one();
            }
        }
    }
}

impl OpenReaders {
    fn forget_gone(&mut self) {
        self.readers.retain(|reader| !locked(&reader.waiting).gone);
    }
}

impl Reader {
    /// Sends the record of the session's end, which is the last one.
    fn end(&self, end: &Arc<[u8]>) {
        let mut waiting = locked(&self.waiting);
        waiting.ring.push(Arc::clone(end));
        waiting.ended = true;
        drop(waiting);
        self.news.notify_one();
        self.over.notify_one();
    }
}

/// Writes the buffered records as fast as the reader reads. After the end of the session, the stream of a reader that
/// does not read is closed.
async fn serve(reader: Arc<Reader>, mut socket: UnixStream) {
    let late = async {
        reader.over.notified().await;
        tokio::time::sleep(DRAIN_TIMEOUT).await;
    };
    tokio::select! {
        () = write(&reader, &mut socket) => {}
        () = late => {}
    }
    locked(&reader.waiting).gone = true;
}

/// Writes until the end is sent, or the reader has closed its socket.
async fn write(reader: &Reader, socket: &mut UnixStream) {
    loop {
        let (record, ended) = {
            let mut waiting = locked(&reader.waiting);
            (waiting.ring.pop(), waiting.ended)
        };
        let goes_on = match record {
            Some(record) => socket.write_all(&record).await.is_ok(),
            None if ended => false,
            None => tokio::select! {
                () = reader.news.notified() => true,
                () = gone(socket) => false,
            },
        };
        if !goes_on {
            return;
        }
    }
}

/// Waits until the other end is closed. A reader that only shut down its sending direction still reads.
async fn gone(socket: &UnixStream) {
    let mut unrequested = [0; 64];
    loop {
        if socket.readable().await.is_err() {
            return;
        }
        match socket.try_read(&mut unrequested) {
            Ok(0) => break,
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
    }
    let both = Interest::READABLE | Interest::WRITABLE;
    match socket.ready(both).await {
        // when the other direction is closed too, the next write detects it
        Ok(ready) if !ready.is_write_closed() => std::future::pending().await,
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use crate::recording::stream::*;
    use dbus::stream::Decoder;
    use std::io::{Read, Write};

    const FRAMES: Wanted = Wanted {
        frames: true,
        maps: false,
        pressure: false,
        quality: false,
        injections: false,
        deviations: false,
        ring: 4,
    };

    fn frame(sequence: u64) -> Record {
        Record {
            sequence,
            wall_ns: 0,
            gap: 0,
            simulated: true,
            body: Body::Frame {
                volts: vec![0.0; 598],
                flags: vec![0; 598],
            },
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn slow_reader_loses_the_oldest_and_gets_their_count() {
        let readers = Readers::default();
        let wanted = FRAMES;
        let fd = readers.add(wanted, ()).unwrap();
        const SENT: u64 = 500;
        for sequence in 1..=SENT {
            readers.publish(&frame(sequence));
            tokio::task::yield_now().await;
        }
        readers.publish(&Record {
            body: Body::End {
                reason: "over".into(),
            },
            ..frame(SENT)
        });
        let read = tokio::task::spawn_blocking(move || {
            let mut bytes = Vec::new();
            std::fs::File::from(fd).read_to_end(&mut bytes).unwrap();
            bytes
        })
        .await
        .unwrap();
        let mut decoder = Decoder::new();
        decoder.push(&read);
        let (mut got, mut lost, mut last) = (0, 0, 0);
        while let Some(record) = decoder.next_record().unwrap() {
            lost += record.gap;
            if let Body::Frame { .. } = record.body {
                assert_eq!(record.sequence, last + record.gap + 1, "the gap is exact");
                last = record.sequence;
                got += 1;
            }
        }
        assert!(lost > 0, "a socket does not hold 500 frames of 5 kB");
        // every frame was either received or counted as lost
        assert_eq!(got + lost, SENT);
    }

    #[tokio::test]
    async fn reader_that_leaves_is_noticed_half_closed_one_is_served() {
        let readers = Readers::default();
        let wanted = Wanted {
            maps: true,
            pressure: true,
            quality: true,
            injections: true,
            deviations: true,
            ..FRAMES
        };
        let (place, given_back) = tokio::sync::oneshot::channel::<()>();
        let fd = readers.add(wanted, place).unwrap();
        let mut stays = std::os::unix::net::UnixStream::from(readers.add(wanted, ()).unwrap());
        stays.write_all(&[7; 200]).unwrap();
        stays.shutdown(std::net::Shutdown::Write).unwrap();
        drop(fd);
        // nothing was published: the closing of the socket itself is detected
        given_back.await.unwrap_err();
        let more = readers.add(wanted, ()).unwrap();
        assert_eq!(
            locked(&readers.open).readers.len(),
            2,
            "who is gone is forgotten"
        );
        drop(more);
        readers.publish(&Record {
            body: Body::End {
                reason: "over".into(),
            },
            ..frame(1)
        });
        let read = tokio::task::spawn_blocking(move || {
            let mut bytes = Vec::new();
            stays.read_to_end(&mut bytes).map(|_| bytes)
        });
        assert!(!read.await.unwrap().unwrap().is_empty());
    }

    #[tokio::test]
    async fn reader_that_comes_after_the_end_gets_it() {
        let readers = Readers::default();
        let wanted = Wanted {
            maps: true,
            ..FRAMES
        };
        let end = Record {
            body: Body::End {
                reason: "over".into(),
            },
            ..frame(7)
        };
        readers.publish(&end);
        let fd = readers.add(wanted, ()).unwrap();
        assert!(readers.is_empty());
        let read = tokio::task::spawn_blocking(move || {
            let mut bytes = Vec::new();
            std::fs::File::from(fd).read_to_end(&mut bytes).unwrap();
            bytes
        });
        let mut decoder = Decoder::new();
        decoder.push(&read.await.unwrap());
        assert_eq!(decoder.next_record().unwrap(), Some(end));
    }

    #[tokio::test(start_paused = true)]
    async fn a_reader_that_does_not_read_is_let_go_after_the_end() {
        let readers = Readers::default();
        let wanted = FRAMES;
        let (place, given_back) = tokio::sync::oneshot::channel::<()>();
        let fd = readers.add(wanted, place).unwrap();
        // more than the socket buffers: a write is in progress when the session ends
        for sequence in 1..=500 {
            readers.publish(&frame(sequence));
            tokio::task::yield_now().await;
        }
        readers.publish(&Record {
            body: Body::End {
                reason: "over".into(),
            },
            ..frame(500)
        });
        // measured by the test's paused clock, which advances when no other task can run
        let let_go = tokio::time::timeout(2 * DRAIN_TIMEOUT, given_back).await;
        let_go.expect("it is let go").unwrap_err();
        drop(fd);
    }
}
