//! A proxy between an uploader and a server: a test can cut it, or let it alter data.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// The other end.
#[derive(Debug, Clone)]
pub enum Far {
    /// A socket of this machine.
    Socket(PathBuf),
    /// A port of this machine.
    Port(u16),
}

/// What a proxy does with the data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProxyMode {
    /// Forwards everything.
    Open,
    /// Forwards nothing and closes connections.
    Cut,
    /// Closes the connection when the uploader sends this text, without forwarding it.
    CutBefore(&'static [u8]),
    /// Closes the connection when the server replies to this text, without forwarding the reply.
    CutAfter(&'static [u8]),
    /// Flips a bit of this text from the uploader, each time.
    Alter(&'static [u8]),
}

pub struct Proxy {
    port: u16,
    mode: Arc<Mutex<ProxyMode>>,
}

/// Both kinds of stream: TCP and Unix sockets.
trait Stream: Read + Write + Send {
    fn end(&self);
    fn twin(&self) -> Box<dyn Stream>;
}

impl Stream for TcpStream {
    fn end(&self) {
        let _ = self.shutdown(Shutdown::Both);
    }
    fn twin(&self) -> Box<dyn Stream> {
        Box::new(self.try_clone().unwrap())
    }
}

impl Stream for UnixStream {
    fn end(&self) {
        let _ = self.shutdown(Shutdown::Both);
    }
    fn twin(&self) -> Box<dyn Stream> {
        Box::new(self.try_clone().unwrap())
    }
}

impl Proxy {
    /// A proxy that forwards to the far end.
    pub fn to(far: Far) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let mode = Arc::new(Mutex::new(ProxyMode::Open));
        let shared = Arc::clone(&mode);
        std::thread::spawn(move || {
            for near in listener.incoming() {
                let Ok(near) = near else { return };
                if *shared.lock().unwrap() == ProxyMode::Cut {
                    continue;
                }
                let opened: std::io::Result<Box<dyn Stream>> = match &far {
                    Far::Socket(path) => UnixStream::connect(path).map(|s| Box::new(s) as _),
                    Far::Port(port) => {
                        TcpStream::connect(("127.0.0.1", *port)).map(|s| Box::new(s) as _)
                    }
                };
                // the far end is unreachable: close the near one
                let Ok(far) = opened else { continue };
                forward(Box::new(near), far, &shared);
            }
        });
        Self { port, mode }
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    pub fn set(&self, mode: ProxyMode) {
        *self.mode.lock().unwrap() = mode;
    }
}

/// Forwards a connection in both directions.
fn forward(near: Box<dyn Stream>, far: Box<dyn Stream>, mode: &Arc<Mutex<ProxyMode>>) {
    // whether the next reply must be dropped
    let cut = Arc::new(Mutex::new(false));
    let (mut from, mut to) = (near.twin(), far.twin());
    let (there, cut_there) = (Arc::clone(mode), Arc::clone(&cut));
    std::thread::spawn(move || {
        let mut block = vec![0; 1 << 16];
        while let Ok(count @ 1..) = from.read(&mut block) {
            let block = &mut block[..count];
            let has = |text: &[u8]| block.windows(text.len()).position(|part| part == text);
            let now = there.lock().unwrap().clone();
            match now {
                ProxyMode::Cut => break,
                ProxyMode::CutBefore(text) if has(text).is_some() => break,
                ProxyMode::CutAfter(text) if has(text).is_some() => {
                    *cut_there.lock().unwrap() = true
                }
                ProxyMode::Alter(text) => {
                    if let Some(at) = has(text) {
                        block[at] ^= 1;
                    }
                }
                _ => {}
            }
            if to.write_all(block).is_err() {
                break;
            }
        }
        from.end();
        to.end();
    });
    let (mut from, mut to) = (far, near);
    let there = Arc::clone(mode);
    std::thread::spawn(move || {
        let mut block = vec![0; 1 << 16];
        while let Ok(count @ 1..) = from.read(&mut block) {
            let ends = *cut.lock().unwrap() || *there.lock().unwrap() == ProxyMode::Cut;
            if ends || to.write_all(&block[..count]).is_err() {
                break;
            }
        }
        from.end();
        to.end();
    });
}
