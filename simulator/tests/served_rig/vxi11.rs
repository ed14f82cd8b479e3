//! The VXI-11 core channel, call by call.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::program::Served;

const CORE: u32 = 0x0006_07AF;
const END: u32 = 8;
const UNTIL_CHARACTER: u32 = 128;
const WAIT_FOR_LOCK: u32 = 1;

/// An ONC RPC client of a few lines.
struct Client {
    stream: TcpStream,
    xid: u32,
}

#[derive(Default)]
struct Arguments(Vec<u8>);

impl Arguments {
    fn word(mut self, word: u32) -> Self {
        self.0.extend(word.to_be_bytes());
        self
    }

    fn opaque(self, bytes: &[u8]) -> Self {
        let mut with = self.word(bytes.len() as u32);
        with.0.extend(bytes);
        with.0.resize(with.0.len().next_multiple_of(4), 0);
        with
    }
}

fn word(bytes: &[u8], index: usize) -> u32 {
    u32::from_be_bytes(bytes[4 * index..4 * index + 4].try_into().unwrap())
}

impl Client {
    fn of(served: &Served) -> Self {
        let stream = TcpStream::connect(served.address("vxi11")).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(DEADLINE)))
            .unwrap();
        Self { stream, xid: 0 }
    }

    /// Sends a record in fragments of `piece` bytes; returns the reply, starting at its accept state.
    fn call_in(
        &mut self,
        piece: usize,
        program: u32,
        version: u32,
        procedure: u32,
        arguments: Arguments,
    ) -> Vec<u8> {
        self.xid += 1;
        let mut record = Arguments::default();
        for each in [self.xid, 0, 2, program, version, procedure, 0, 0, 0, 0] {
            record = record.word(each);
        }
        record.0.extend(arguments.0);
        let mut pieces = record.0.chunks(piece).peekable();
        while let Some(bytes) = pieces.next() {
            let last = u32::from(pieces.peek().is_none()) << 31;
            let mark = bytes.len() as u32 | last;
            self.stream.write_all(&mark.to_be_bytes()).unwrap();
            self.stream.write_all(bytes).unwrap();
        }
        let mut mark = [0; 4];
        self.stream.read_exact(&mut mark).unwrap();
        let length = u32::from_be_bytes(mark) & !(1 << 31);
        let mut reply = vec![0; length as usize];
        self.stream.read_exact(&mut reply).unwrap();
        assert_eq!(word(&reply, 0), self.xid);
        assert_eq!(word(&reply, 1), 1, "a reply");
        // Accepted, no verifier.
        assert_eq!([2, 3, 4].map(|index| word(&reply, index)), [0, 0, 0]);
        reply.split_off(20)
    }

    fn call(&mut self, procedure: u32, arguments: Arguments) -> Vec<u8> {
        let mut reply = self.call_in(usize::MAX, CORE, 1, procedure, arguments);
        assert_eq!(word(&reply, 0), 0, "accepted");
        reply.split_off(4)
    }

    fn create(&mut self, name: &[u8]) -> Result<u32, u32> {
        let created = self.call(
            10,
            Arguments::default().word(1).word(0).word(0).opaque(name),
        );
        match word(&created, 0) {
            0 => Ok(word(&created, 1)),
            fault => Err(fault),
        }
    }

    fn write(&mut self, link: u32, text: &[u8], flags: u32) -> u32 {
        let head = Arguments::default()
            .word(link)
            .word(5000)
            .word(0)
            .word(flags);
        let written = self.call(11, head.opaque(text));
        let taken = word(&written, 1) as usize;
        assert!(taken == text.len() || word(&written, 0) != 0);
        word(&written, 0)
    }

    /// Error, reason, data.
    fn read(
        &mut self,
        link: u32,
        most: u32,
        timeout: u32,
        until: Option<u8>,
    ) -> (u32, u32, String) {
        let flags = if until.is_some() { UNTIL_CHARACTER } else { 0 };
        let head = Arguments::default()
            .word(link)
            .word(most)
            .word(timeout)
            .word(0);
        let read = self.call(12, head.word(flags).word(until.unwrap_or(0).into()));
        let length = word(&read, 2) as usize;
        let data = String::from_utf8(read[12..12 + length].to_vec()).unwrap();
        (word(&read, 0), word(&read, 1), data)
    }

    fn ask(&mut self, link: u32, query: &str) -> String {
        assert_eq!(self.write(link, query.as_bytes(), END), 0);
        let (error, reason, data) = self.read(link, 1 << 20, 5000, None);
        assert_eq!((error, reason), (0, 4), "{data}");
        data.trim_end().to_owned()
    }

    fn generic(&mut self, procedure: u32, link: u32, flags: u32, lock: u32) -> Vec<u8> {
        let head = Arguments::default().word(link).word(flags).word(lock);
        self.call(procedure, head.word(1000))
    }

    fn lock(&mut self, link: u32, flags: u32, timeout: u32) -> u32 {
        word(
            &self.call(
                18,
                Arguments::default().word(link).word(flags).word(timeout),
            ),
            0,
        )
    }

    fn unlock(&mut self, link: u32) -> u32 {
        word(&self.call(19, Arguments::default().word(link)), 0)
    }

    fn code(&mut self, link: u32) -> i32 {
        let error = self.ask(link, "SYST:ERR?\n");
        error.split(',').next().unwrap().parse().unwrap()
    }
}

fn served() -> Served {
    Served::start(&["--port-vxi11", "0"])
}

#[test]
fn a_link_reads_in_pieces_and_gives_the_reason_of_the_end() {
    let served = served();
    let mut client = Client::of(&served);
    assert_eq!(client.create(b"gpib0,9"), Err(3));
    let link = client.create(b"inst0").unwrap();
    assert_eq!(client.ask(link, "SYST:LOCK:NAME?"), "VXI11");
    let identity = client.ask(link, "*IDN?");
    assert!(identity.contains("34980A"));
    // A message in three writes, ended by END or by a line feed.
    assert_eq!(client.write(link, b"*I", 0), 0);
    assert_eq!(client.write(link, b"DN", 0), 0);
    assert_eq!(client.write(link, b"?", END), 0);
    assert_eq!(
        client.read(link, 7, 5000, None),
        (0, 1, identity[..7].to_owned())
    );
    let (error, reason, model) = client.read(link, 1000, 5000, Some(b','));
    assert_eq!((error, reason), (0, 2), "{model}");
    let (error, reason, rest) = client.read(link, 1000, 5000, None);
    assert_eq!((error, reason), (0, 4));
    assert_eq!(
        format!("{}{model}{rest}", &identity[..7]),
        format!("{identity}\n")
    );
    assert_eq!(client.write(link, b"*IDN?\n", 0), 0);
    assert_eq!(client.read(link, 1000, 5000, Some(b'\n')).1, 2 | 4);
    // Twenty thousand bytes in two writes.
    let long = format!("{}*ESE 8;*ESE?", "*ESE 1;".repeat(3000));
    let (first, second) = long.as_bytes().split_at(16_000);
    assert_eq!(client.write(link, first, 0), 0);
    assert_eq!(client.write(link, second, END), 0);
    assert_eq!(client.read(link, 1000, 5000, None).2, "+8\n");
    assert_eq!(client.code(link), 0);
}

#[test]
fn unread_and_unrequested_replies_are_errors() {
    let served = served();
    let mut client = Client::of(&served);
    let link = client.create(b"inst0").unwrap();
    assert_eq!(client.write(link, b"*IDN?", END), 0);
    // The next message interrupts the reply only after it is available.
    while word(&client.generic(13, link, 0, 0), 1) & 16 == 0 {}
    assert_eq!(client.ask(link, "*ESE?"), "+0");
    assert_eq!(client.code(link), -410);
    let begun = Instant::now();
    assert_eq!(client.read(link, 100, 300, None).0, 15);
    assert!(begun.elapsed() >= Duration::from_millis(300));
    assert_eq!(client.code(link), -420);
    assert_eq!(client.code(link), 0);
    // A device clear discards the reply and half a message, without an error.
    assert_eq!(client.write(link, b"*IDN?\n*ID", 0), 0);
    while word(&client.generic(13, link, 0, 0), 1) & 16 == 0 {}
    assert_eq!(word(&client.generic(15, link, 0, 0), 0), 0);
    assert_eq!(client.ask(link, "*ESE?"), "+0");
    assert_eq!(client.code(link), 0);
    // Too many bytes without an end of message.
    for _ in 0..5 {
        assert_eq!(client.write(link, &[b'A'; 16_000], 0), 0);
    }
    assert_eq!(client.write(link, b"\n", 0), 0);
    assert_eq!(client.code(link), -363);
}

#[test]
fn vxi11_trigger_follows_earlier_messages_and_has_a_reply() {
    let served = Served::start_in_time(&["--port-vxi11", "0"]);
    let mut client = Client::of(&served);
    let link = client.create(b"inst0").unwrap();
    // The second message waits for the readings of the first: otherwise its trigger would be ignored, and FETC? would
    // return no reading.
    let long = b"CONF:VOLT:DC 1,(@1001);:VOLT:DC:NPLC 10,(@1001);:READ?";
    assert_eq!(client.write(link, long, END), 0);
    assert_eq!(client.write(link, b"TRIG:SOUR BUS;:INIT", END), 0);
    assert_eq!(word(&client.generic(14, link, 0, 0), 0), 0);
    assert_eq!(client.ask(link, "FETC?").split(',').count(), 1);
    // The reply to READ? was not read, which is the only error.
    assert_eq!(client.code(link), -410);
    assert_eq!(client.code(link), 0);
    // A trigger while the instrument does not wait for one is an error, and interrupts no reply.
    assert_eq!(client.write(link, b"*IDN?", END), 0);
    assert_eq!(word(&client.generic(14, link, 0, 0), 0), 0);
    assert!(client.read(link, 100, 5000, None).2.contains("34980A"));
    assert_eq!(client.code(link), -211);
    assert_eq!(client.code(link), 0);
}

/// More than two hours of integration: a test that waits for its end is killed first.
const LONG_SCAN: &[u8] =
    b"CONF:VOLT:DC 1,(@1001:1010);:VOLT:DC:NPLC 200,(@1001:1010);:TRIG:COUN 100;:READ?\n";
/// Ends a hung test, s.
const DEADLINE: u64 = 120;

#[test]
fn device_clear_aborts_measurement_and_poll_does_not_wait() {
    let served = Served::start_in_time(&["--port-vxi11", "0"]);
    let mut client = Client::of(&served);
    let link = client.create(b"inst0").unwrap();
    assert_eq!(client.write(link, LONG_SCAN, END), 0);
    // Nothing is available yet: the status is returned immediately.
    assert_eq!(word(&client.generic(13, link, 0, 0), 1) & 16, 0);
    assert_eq!(client.read(link, 100, 50, None).0, 15);
    assert_eq!(word(&client.generic(15, link, 0, 0), 0), 0);
    assert_eq!(client.ask(link, "*ESE?"), "+0");
    assert_eq!(
        client.ask(link, "STAT:OPER:COND?;:ROUT:SCAN:SIZE?"),
        "+0;+10"
    );
    assert_eq!(client.code(link), 0);
}

#[test]
fn an_abort_ends_a_read_that_waits() {
    let served = Served::start_in_time(&["--port-vxi11", "0"]);
    let mut client = Client::of(&served);
    let link = client.create(b"inst0").unwrap();
    assert_eq!(client.write(link, LONG_SCAN, END), 0);
    let mut other = Client::of(&served);
    // The abort fails until the read has started; then the read ends.
    let (ended, reported) = std::sync::mpsc::channel::<()>();
    let aborter = std::thread::spawn(move || {
        while reported.try_recv() == Err(std::sync::mpsc::TryRecvError::Empty) {
            let aborted = other.call_in(999, CORE + 1, 1, 1, Arguments::default().word(link));
            assert_eq!((word(&aborted, 0), word(&aborted, 1)), (0, 0));
        }
    });
    assert_eq!(client.read(link, 100, 3_600_000, None).0, 23);
    drop(ended);
    aborter.join().unwrap();
}

#[test]
fn one_link_locks_the_others_out() {
    let served = served();
    let (mut mine, mut other) = (Client::of(&served), Client::of(&served));
    let link = mine.create(b"inst0").unwrap();
    let stranger = other.create(b"inst0").unwrap();
    assert_eq!(mine.unlock(link), 12);
    assert_eq!(mine.lock(link, 0, 0), 0);
    assert_eq!(other.write(stranger, b"*IDN?", END), 11);
    assert_eq!(other.lock(stranger, 0, 0), 11);
    let begun = Instant::now();
    assert_eq!(other.lock(stranger, WAIT_FOR_LOCK, 200), 11);
    assert!(begun.elapsed() >= Duration::from_millis(200));
    assert!(mine.ask(link, "*IDN?").contains("34980A"));
    assert_eq!(mine.unlock(link), 0);
    assert!(other.ask(stranger, "*IDN?").contains("34980A"));
    // A closed connection releases its locks.
    assert_eq!(other.lock(stranger, 0, 0), 0);
    drop(other);
    assert_eq!(mine.lock(link, WAIT_FOR_LOCK, 3_600_000), 0);
    let destroyed = mine.call(23, Arguments::default().word(link));
    assert_eq!(word(&destroyed, 0), 0);
    assert_eq!(mine.write(link, b"*IDN?", END), 4);
}

#[test]
fn a_message_that_is_no_call_is_refused_by_the_rpc_rules() {
    let served = served();
    let mut client = Client::of(&served);
    // In fragments of three bytes each.
    let null = client.call_in(3, CORE, 1, 0, Arguments::default());
    assert_eq!(null, [0; 4]);
    assert_eq!(
        word(&client.call_in(999, 100_000, 2, 3, Arguments::default()), 0),
        1
    );
    assert_eq!(
        word(&client.call_in(999, CORE, 7, 10, Arguments::default()), 0),
        2
    );
    assert_eq!(
        word(&client.call_in(999, CORE, 1, 99, Arguments::default()), 0),
        3
    );
    assert_eq!(
        word(
            &client.call_in(999, CORE, 1, 10, Arguments::default().word(1)),
            0
        ),
        4
    );
    let lie = Arguments::default().word(1).word(0).word(0).word(u32::MAX);
    assert_eq!(word(&client.call_in(999, CORE, 1, 10, lie), 0), 4);
    // The interrupt channel and docmd are not supported, and return an error.
    assert_eq!(word(&client.call(26, Arguments::default()), 0), 8);
    // The abort program is on the same port.
    let aborted = client.call_in(999, CORE + 1, 1, 1, Arguments::default().word(12_345));
    assert_eq!((word(&aborted, 0), word(&aborted, 1)), (0, 4));
    // A record that is too long closes its connection only.
    client.stream.write_all(&[0xff; 64]).unwrap();
    let mut rest = Vec::new();
    assert!(
        client
            .stream
            .read_to_end(&mut rest)
            .is_ok_and(|count| count == 0)
            || rest.is_empty()
    );
    let mut next = Client::of(&served);
    let link = next.create(b"inst0").unwrap();
    assert!(next.ask(link, "*IDN?").contains("34980A"));
    // A message in one call, longer than the advertised maximum.
    let long = "*ESE 1;".repeat(3000);
    assert_eq!(next.ask(link, &format!("{long}*ESE?")), "+1");
}

#[test]
fn the_identification_document_is_that_of_the_instrument() {
    let served = Served::start(&["--port-vxi11", "0", "--port-http", "0"]);
    let get = |request: &str| {
        let mut stream = TcpStream::connect(served.address("http")).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut page = String::new();
        stream.read_to_string(&mut page).unwrap();
        page
    };
    let page = get("GET /lxi/identification HTTP/1.1\r\nHost: here\r\n\r\n");
    assert!(
        page.starts_with("HTTP/1.1 200 OK\r\nContent-Type: text/xml"),
        "{page}"
    );
    let fields = ["Manufacturer", "Model", "SerialNumber", "FirmwareRevision"].map(|name| {
        let start = page.find(&format!("<{name}>")).unwrap() + name.len() + 2;
        let end = page.find(&format!("</{name}>")).unwrap();
        page[start..end].to_owned()
    });
    let mut client = Client::of(&served);
    let link = client.create(b"inst0").unwrap();
    assert_eq!(fields.join(","), client.ask(link, "*IDN?"));
    let port = served.address("vxi11").rsplit(':').next().unwrap();
    assert!(
        page.contains(&format!("TCPIP::127.0.0.1,{port}::inst0::INSTR")),
        "{page}"
    );
    assert!(get("GET / HTTP/1.0\r\n\r\n").contains("34980A, simulated"));
    assert!(get("GET /other HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 404"));
    assert!(get("POST / HTTP/1.1\r\n\r\n").contains("Allow: GET"));
    assert!(get("nonsense\r\n\r\n").starts_with("HTTP/1.1 400"));
    let flood = format!("GET / HTTP/1.1\r\nX: {}", "x".repeat(8192));
    assert!(get(&flood).starts_with("HTTP/1.1 431"));
}
