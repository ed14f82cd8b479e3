//! A link to a peer that delays, splits, merges, duplicates and drops replies, and that disconnects.

use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::Duration;

use proptest::prelude::*;
use rig::{Link, LinkError};
use tokio::io::{
    AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, BufReader, DuplexStream,
    ReadBuf, duplex,
};
use tokio::time::sleep;

const DEADLINE: Duration = Duration::from_millis(100);

/// What the peer does with the reply to one query.
#[derive(Debug, Clone, Copy)]
enum Manner {
    Prompt,
    Delay(u64),
    Split(usize),
    /// Delayed and sent together with the next reply.
    Merge,
    /// Sent twice, the second time after this number of milliseconds.
    Double(u64),
    Drop,
    /// The beginning of the reply, then nothing more.
    Truncate(usize),
    HangUp,
}

fn manner() -> impl Strategy<Value = Manner> {
    prop_oneof![
        4 => Just(Manner::Prompt),
        2 => (1..400_u64).prop_map(Manner::Delay),
        2 => (0..6_usize).prop_map(Manner::Split),
        1 => Just(Manner::Merge),
        2 => (0..5_u64).prop_map(Manner::Double),
        1 => Just(Manner::Drop),
        1 => (0..3_usize).prop_map(Manner::Truncate),
        1 => Just(Manner::HangUp),
    ]
}

/// Replies to `Q<n>?` with `A<n>` as scripted for n, and to `*ESE` as any instrument does.
async fn peer(
    stream: DuplexStream,
    script: Arc<Vec<Manner>>,
    enable: Arc<Mutex<u8>>,
    may_hang_up: bool,
) {
    let (read, mut write) = tokio::io::split(stream);
    let mut lines = BufReader::new(read).lines();
    let mut kept = String::new();
    while let Ok(Some(line)) = lines.next_line().await {
        let mut answers: Vec<String> = Vec::new();
        let mut manner = Manner::Prompt;
        for unit in line.split(';').filter(|unit| !unit.is_empty()) {
            if let Some(number) = unit.strip_prefix('Q').and_then(|q| q.strip_suffix('?')) {
                manner = script[number.parse::<usize>().unwrap()];
                answers.push(format!("A{number}"));
            } else if unit == "*ESE?" {
                answers.push(enable.lock().unwrap().to_string());
            } else if let Some(value) = unit.strip_prefix("*ESE ") {
                *enable.lock().unwrap() = value.parse().unwrap();
            }
        }
        if answers.is_empty() {
            continue;
        }
        let answer = format!("{}{}\n", std::mem::take(&mut kept), answers.join(";"));
        let sent = match manner {
            Manner::Prompt => write.write_all(answer.as_bytes()).await,
            Manner::Delay(ms) => {
                sleep(Duration::from_millis(ms)).await;
                write.write_all(answer.as_bytes()).await
            }
            Manner::Split(at) => {
                let (head, tail) = answer.as_bytes().split_at(at.min(answer.len()));
                write.write_all(head).await.unwrap_or(());
                sleep(Duration::from_millis(7)).await;
                write.write_all(tail).await
            }
            Manner::Merge => {
                kept = answer;
                Ok(())
            }
            Manner::Double(ms) => {
                write.write_all(answer.as_bytes()).await.unwrap_or(());
                if ms > 0 {
                    sleep(Duration::from_millis(ms)).await;
                }
                write.write_all(answer.as_bytes()).await
            }
            Manner::Drop => Ok(()),
            Manner::Truncate(at) => {
                write
                    .write_all(&answer.as_bytes()[..at.min(answer.len())])
                    .await
            }
            Manner::HangUp if may_hang_up => return,
            Manner::HangUp => Ok(()),
        };
        if sent.is_err() {
            return;
        }
    }
}

fn paused() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn late_reply_is_discarded_on_a_reconnecting_link(
        script in prop::collection::vec(manner(), 1..25),
    ) {
        paused().block_on(async {
            let script = Arc::new(script);
            let enable = Arc::new(Mutex::new(0));
            let open = || {
                let (here, there) = duplex(4096);
                tokio::spawn(peer(there, script.clone(), enable.clone(), true));
                here
            };
            let mut link = Link::new(open(), "peer", DEADLINE);
            for number in 0..script.len() {
                match link.ask(&format!("Q{number}?")).await {
                    Ok(answer) => assert_eq!(answer, format!("A{number}"), "{script:?}"),
                    Err(_) => {
                        assert!(!link.is_synchronised());
                        assert!(matches!(link.ask("Q0?").await, Err(LinkError::Unsynchronised { .. })));
                        link = Link::new(open(), "peer", DEADLINE);
                    }
                }
                // A duplicate arrives within 5 ms; one that arrives after the next query cannot be detected.
                sleep(Duration::from_millis(6)).await;
            }
        });
    }

    #[test]
    fn late_reply_is_discarded_on_a_permanent_line(
        script in prop::collection::vec(manner(), 1..25),
        value in 0..=255_u8,
    ) {
        paused().block_on(async {
            let script = Arc::new(script);
            let enable = Arc::new(Mutex::new(value));
            let (here, there) = duplex(4096);
            tokio::spawn(peer(there, script.clone(), enable.clone(), false));
            let mut link = Link::new(here, "peer", DEADLINE);
            for number in 0..script.len() {
                match link.ask(&format!("Q{number}?")).await {
                    Ok(answer) => assert_eq!(answer, format!("A{number}"), "{script:?}"),
                    Err(_) => {
                        assert!(matches!(link.send("Q0?").await, Err(LinkError::Unsynchronised { .. })));
                        let mut tries = 0;
                        while let Err(fault) = link.resynchronise().await {
                            tries += 1;
                            assert!(tries < 8, "{fault} after {script:?}");
                        }
                        assert_eq!(*enable.lock().unwrap(), value, "{script:?}");
                    }
                }
                sleep(Duration::from_millis(6)).await;
            }
        });
    }
}

/// Counts the writes to the connection.
struct Counting<S>(S, Arc<AtomicUsize>);

impl<S: AsyncRead + Unpin> AsyncRead for Counting<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.0).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Counting<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        self.1.fetch_add(1, Ordering::SeqCst);
        Pin::new(&mut self.0).poll_write(context, bytes)
    }
    fn poll_flush(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(context)
    }
    fn poll_shutdown(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<std::io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(context)
    }
}

#[tokio::test(start_paused = true)]
async fn a_message_and_its_end_are_one_write() {
    let (here, mut there) = duplex(4096);
    let writes = Arc::new(AtomicUsize::new(0));
    let mut link = Link::new(Counting(here, writes.clone()), "peer", DEADLINE);
    link.send("ROUT:CLOS (@1037);:ROUT:OPEN (@1036)")
        .await
        .unwrap();
    assert_eq!(writes.load(Ordering::SeqCst), 1);
    let mut received = [0; 64];
    let count = there.read(&mut received).await.unwrap();
    assert_eq!(
        &received[..count],
        b"ROUT:CLOS (@1037);:ROUT:OPEN (@1036)\n"
    );
}

#[tokio::test(start_paused = true)]
async fn no_reply_is_a_timeout_that_names_instrument_and_query() {
    let (here, _there) = duplex(4096);
    let mut link = Link::new(here, "6221 at 10.0.0.7:1394", DEADLINE);
    let fault = link.ask("*IDN?").await.unwrap_err();
    assert_eq!(
        fault.to_string(),
        "6221 at 10.0.0.7:1394 did not answer '*IDN?' within 100ms"
    );
    assert!(matches!(
        link.ask("*IDN?").await,
        Err(LinkError::Unsynchronised { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn a_future_dropped_half_way_leaves_the_link_out_of_step() {
    let (here, _there) = duplex(4096);
    let mut link = Link::new(here, "peer", DEADLINE);
    tokio::select! {
        _ = link.ask("READ?") => unreachable!("nobody answers"),
        () = sleep(Duration::from_millis(10)) => {}
    }
    assert!(!link.is_synchronised());
}

#[tokio::test(start_paused = true)]
async fn unrequested_replies_are_refused() {
    let (here, mut there) = duplex(4096);
    let mut link = Link::new(here, "peer", DEADLINE);
    there.write_all(b"+1.0E+00\n").await.unwrap();
    let fault = link.ask("READ?").await.unwrap_err();
    assert_eq!(fault.to_string(), "peer sent '+1.0E+00' without a query");
}

#[tokio::test(start_paused = true)]
async fn a_reply_without_end_is_bounded() {
    let (here, mut there) = duplex(1 << 20);
    let mut link = Link::new(here, "peer", DEADLINE).with_longest_reply(1000);
    let flood = async {
        let mut received = [0; 6];
        there.read_exact(&mut received).await.unwrap();
        there.write_all(&[b'7'; 5000]).await.unwrap();
    };
    let (answer, ()) = tokio::join!(link.ask("DATA?"), flood);
    assert!(
        matches!(answer, Err(LinkError::TooLong { most: 1000, .. })),
        "{answer:?}"
    );
}

#[tokio::test(start_paused = true)]
async fn bytes_that_are_no_text_and_messages_that_are_two_are_refused() {
    let (here, mut there) = duplex(4096);
    let mut link = Link::new(here, "peer", DEADLINE);
    assert!(matches!(
        link.send("OUTP 1\nOUTP 0").await,
        Err(LinkError::LineEnd { .. })
    ));
    let answer = async {
        let mut received = [0; 6];
        there.read_exact(&mut received).await.unwrap();
        there.write_all(&[0xff, 0xfe, b'\n']).await.unwrap();
    };
    let (requested, ()) = tokio::join!(link.ask("DATA?"), answer);
    assert!(matches!(requested, Err(LinkError::NotText { .. })));
}

#[tokio::test(start_paused = true)]
async fn a_peer_that_hung_up_is_noticed_before_the_next_message() {
    let (here, there) = duplex(4096);
    let mut link = Link::new(here, "peer", DEADLINE);
    drop(there);
    assert!(matches!(
        link.send("OUTP 0").await,
        Err(LinkError::Lost { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn a_board_without_ese_is_brought_in_step_by_probes_of_its_own() {
    let (here, there) = duplex(4096);
    let mut link = Link::new(here, "board", DEADLINE);
    let board = tokio::spawn(async move {
        let (read, mut write) = tokio::io::split(there);
        let mut lines = BufReader::new(read).lines();
        while let Ok(Some(line)) = lines.next_line().await {
            let answer = match line.as_str() {
                "" => continue,
                "STAT?" => {
                    sleep(Duration::from_millis(150)).await;
                    "1,2,3,4\n".to_owned()
                }
                message => format!("{message} OK\n"),
            };
            write.write_all(answer.as_bytes()).await.unwrap();
        }
    });
    link.ask("STAT?").await.unwrap_err();
    link.resynchronise_by(&[("WDOG 2001", "WDOG 2001 OK"), ("WDOG 2000", "WDOG 2000 OK")])
        .await
        .unwrap();
    assert_eq!(link.ask("OFF").await.unwrap(), "OFF OK");
    drop(link);
    board.await.unwrap();
}

/// An instrument that serves one client keeps the connection slot of a lost client until it receives data from that
/// port.
#[tokio::test]
async fn every_other_reconnection_uses_the_lost_local_port() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mut ports = Vec::new();
    for speaks in [true, false, false, true, false, false] {
        let deadline = Duration::from_secs(60);
        let (ours, theirs) = tokio::join!(rig::connect_tcp(&address, deadline), listener.accept());
        let (mut ours, (mut theirs, from)) = (ours.unwrap(), theirs.unwrap());
        ports.push(from.port());
        if speaks {
            theirs.write_all(b"hello").await.unwrap();
            ours.read_exact(&mut [0; 5]).await.unwrap();
        }
        // closed at once, as after a loss: nothing waits for the end of the connection
        rustix::net::sockopt::set_socket_linger(&theirs, Some(Duration::ZERO)).unwrap();
        drop(theirs);
        ours.read(&mut [0]).await.unwrap_err();
    }
    let [lost, other, same, third, another, same_again] = ports[..] else {
        panic!("{ports:?}");
    };
    assert_ne!(lost, other);
    assert_eq!(lost, same);
    assert_ne!(third, another);
    assert_eq!(third, same_again);
}

#[tokio::test]
async fn tcp_is_connected_and_an_unreachable_address_is_named() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mut link = Link::new(
        rig::connect_tcp(&address, Duration::from_secs(5))
            .await
            .unwrap(),
        "echo",
        Duration::from_secs(5),
    );
    let (mut peer, _) = listener.accept().await.unwrap();
    let await_echo = async {
        let mut received = [0; 6];
        peer.read_exact(&mut received).await.unwrap();
        peer.write_all(&received).await.unwrap();
    };
    let (answer, ()) = tokio::join!(link.ask("*IDN?"), await_echo);
    assert_eq!(answer.unwrap(), "*IDN?");
    drop((listener, peer));
    let refusal = rig::connect_tcp(&address, Duration::from_secs(5))
        .await
        .err()
        .unwrap();
    assert!(refusal.to_string().contains(&address), "{refusal}");
    let missing = rig::open_serial("/dev/no-such-board", 115_200)
        .err()
        .unwrap();
    assert!(
        missing.to_string().contains("/dev/no-such-board"),
        "{missing}"
    );
}
