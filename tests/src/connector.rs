//! Connects to unix sockets as the user that runs it, and passes each connection to its parent. The kernel, and so a
//! message bus, attributes a connection to the user of the process that made it, whichever process holds it later.
//!
//! Standard input is a socket. Each line on it is the path of a socket to connect to; the reply is one byte: 0 with the
//! connection's descriptor, or the error number. The program ends when the parent closes its end.

use std::io::{self, BufRead, BufReader, IoSlice, Write};
use std::mem::MaybeUninit;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::ExitCode;

use rustix::net::{SendAncillaryBuffer, SendAncillaryMessage, SendFlags, sendmsg};

fn main() -> ExitCode {
    match serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("connector: {error}");
            ExitCode::FAILURE
        }
    }
}

fn serve() -> io::Result<()> {
    let mut parent = UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?);
    for path in BufReader::new(parent.try_clone()?).lines() {
        match UnixStream::connect(path?) {
            Ok(connection) => hand_over(&parent, &connection)?,
            Err(error) => {
                let number = error
                    .raw_os_error()
                    .and_then(|code| u8::try_from(code).ok());
                parent.write_all(&[number.unwrap_or(u8::MAX)])?;
            }
        }
    }
    Ok(())
}

fn hand_over(parent: &UnixStream, connection: &UnixStream) -> io::Result<()> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    let connections = [connection.as_fd()];
    control.push(SendAncillaryMessage::ScmRights(&connections));
    sendmsg(
        parent,
        &[IoSlice::new(&[0])],
        &mut control,
        SendFlags::empty(),
    )?;
    Ok(())
}
